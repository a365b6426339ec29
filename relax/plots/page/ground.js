// The ground as a sheet with a grid, metres along its edges that are nearer to the eye, and heights on an upright.

// Round numbers between low and high, some `count` of them.
function ticks(low, high, count) {
  const rough = (high - low) / count || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((share) => share * power >= 0.999 * rough);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
}

class Ground {
  constructor(scene, record, label) {
    const { low, high, ground, origin, size } = record;
    this.corners = [low, high].flatMap((x) => [low, high].map((y) => new THREE.Vector3(x[0], y[1], ground)));
    this.centre = new THREE.Vector3((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, ground);
    this.sheet = new THREE.Mesh(new THREE.PlaneGeometry(high[0] - low[0], high[1] - low[1]), new THREE.MeshBasicMaterial());
    this.sheet.position.copy(this.centre);
    const lines = [];
    this.marks = [];
    for (const [axis, other] of [[0, 1], [1, 0]]) {
      for (const value of ticks(low[axis] + origin[axis], high[axis] + origin[axis], 6)) {
        const at = value - origin[axis];
        const ends = [low[other], high[other]].map((end) => (axis ? [end, at, ground] : [at, end, ground]));
        lines.push(...ends.flat());
        this.marks.push({ axis, ends, element: label(shown(value, 6), "tick") });
      }
    }
    const upright = [0, 0, low[2], 0, 0, high[2]];
    const levels = ticks(low[2] + origin[2], high[2] + origin[2], 3).map((value) => value - origin[2]);
    const notch = 0.012 * size;
    for (const level of levels) upright.push(-notch, 0, level, notch, 0, level, 0, -notch, level, 0, notch, level);
    // the lowest number would stand on those of the ground
    const clear = levels.filter((level) => level - low[2] > 0.04 * size);
    this.heights = clear.map((level) => ({ level, element: label(`${shown(level + origin[2], 6)} m`, "tick height") }));
    const thin = (points) => {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(points), 3));
      return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial());
    };
    [this.grid, this.upright] = [thin(lines), thin(upright)];
    // what stands below the ground is seen
    [this.sheet, this.grid].forEach((part, i) => {
      part.renderOrder = i - 2;
      part.material.depthWrite = false;
    });
    scene.add(this.sheet, this.grid, this.upright);
  }

  paint(colour) {
    this.sheet.material.color.set(colour("--sheet"));
    this.grid.material.color.set(colour("--grid"));
    this.upright.material.color.set(colour("--soft"));
  }

  // Put numbers and upright where an eye at `position` reads them; `pixel` projects a point, `move` puts a label at one.
  place(position, pixel, move) {
    const eye = position.clone().sub(this.centre);
    for (const { axis, ends, element } of this.marks) {
      const end = new THREE.Vector3(...ends[(axis ? eye.x : eye.y) > 0 ? 1 : 0]);
      const middle = end.clone().setComponent(axis, this.centre.getComponent(axis));
      move(element, end.addScaledVector(middle.sub(this.centre), 0.06));
    }
    const left = this.corners.reduce((one, other) => (pixel(other)[0] < pixel(one)[0] ? other : one));
    this.upright.position.set(left.x, left.y, 0);
    for (const { level, element } of this.heights) move(element, new THREE.Vector3(left.x, left.y, level), [-8, 0]);
  }
}
