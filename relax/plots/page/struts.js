// The supports of a step as struts with head and foot, as thick as their force says, and the fixed points.

const AREA = 9000; // square pixels of canvas that a number beside a support asks for
const THICK = 0.0042; // radius of the strut with the largest force, a share of the scene
const UPRIGHT = new THREE.Vector3(0, 1, 0); // what three.js calls up for a cylinder

class Struts {
  constructor(scene, record, label) {
    Object.assign(this, { scene, record, label, named: [] });
    // heads and fixed points are balls alike
    this.most = record.points.length + Math.max(1, ...record.counts);
    this.rods = this.many(new THREE.CylinderGeometry(1, 1, 1, 12));
    this.balls = this.many(new THREE.SphereGeometry(1, 16, 12));
    this.feet = {
      mast: this.many(new THREE.BoxGeometry(2.6, 1, 2.6)),
      "tie-down": this.many(new THREE.ConeGeometry(1.7, 3, 16)),
      stay: this.many(new THREE.ConeGeometry(1.9, 4.5, 16)),
    };
    this.kinds = [this.rods, this.balls, ...Object.values(this.feet)];
    this.full = record.supports(record.last).reduce((most, one) => Math.max(most, one.magnitude), 0);
  }

  // One shape many times, and faintly once more where something stands before it.
  many(geometry) {
    const solid = new THREE.InstancedMesh(geometry, new THREE.MeshLambertMaterial(), this.most);
    solid.setColorAt(0, new THREE.Color());
    const hidden = { transparent: true, opacity: 0.35, depthFunc: THREE.GreaterDepth, depthWrite: false };
    const behind = new THREE.InstancedMesh(geometry, new THREE.MeshBasicMaterial(hidden), this.most);
    Object.assign(behind, { instanceMatrix: solid.instanceMatrix, instanceColor: solid.instanceColor });
    for (const mesh of [solid, behind]) {
      mesh.frustumCulled = false;
      mesh.count = 0; // until a step is shown: else so many balls of a metre would be painted first
    }
    this.scene.add(solid, behind);
    return { solid, behind, count: 0 };
  }

  put(kind, centre, along, size, colour) {
    const turn = new THREE.Quaternion().setFromUnitVectors(UPRIGHT, along);
    kind.solid.setMatrixAt(kind.count, new THREE.Matrix4().compose(centre, turn, size));
    kind.solid.setColorAt(kind.count++, colour);
  }

  paint(colour) {
    const named = { mast: colour("--mast"), chosen: colour("--chosen"), held: colour("--held") };
    this.colours = { ...this.record.kinds, ...named };
  }

  // Show the supports of a step; `vertex` is the chosen one, `area` what the canvas has for numbers, square pixels.
  show(step, vertex, positions, area) {
    const supports = this.record.supports(step);
    for (const kind of this.kinds) kind.count = 0;
    for (const { label } of this.named) label?.remove();
    this.named = supports.map((support) => this.stand(support, support.vertex === vertex, supports.length * AREA <= area));
    const radius = THICK * this.record.size;
    const ball = new THREE.Vector3(radius, radius, radius);
    for (const v of this.record.points) {
      const place = new THREE.Vector3(...positions.subarray(3 * v, 3 * v + 3));
      this.put(this.balls, place, UPRIGHT, ball, new THREE.Color(this.colours.held));
    }
    for (const { solid, behind, count } of this.kinds) {
      solid.count = behind.count = count;
      solid.instanceMatrix.needsUpdate = solid.instanceColor.needsUpdate = true;
    }
  }

  stand(support, chosen, told) {
    const [head, end] = [new THREE.Vector3(...support.head), new THREE.Vector3(...support.end)];
    const share = Math.min(1, Math.sqrt(support.magnitude / (this.full || support.magnitude)));
    const radius = THICK * this.record.size * (chosen ? 1.5 : 1) * (0.12 + 0.88 * share) * (support.kind === "mast" ? 1 : 0.75);
    const colour = new THREE.Color(this.colours[chosen ? "chosen" : support.kind]);
    const run = end.clone().sub(head);
    const length = run.length();
    const along = length > 0 ? run.clone().divideScalar(length) : UPRIGHT;
    const even = new THREE.Vector3(radius, radius, radius);
    this.put(this.rods, head.clone().addScaledVector(run, 0.5), along, new THREE.Vector3(radius, length, radius), colour);
    this.put(this.balls, head, along, even.clone().multiplyScalar(1.5), colour);
    const away = support.kind === "stay" ? along : new THREE.Vector3(0, 0, 1);
    if (support.kind === "stay" || support.whole) this.put(this.feet[support.kind], end, away, even, colour);
    const style = chosen ? "head chosen" : "head";
    return { support, head, end, label: told || chosen ? this.label(String(support.vertex), style) : null };
  }
}
