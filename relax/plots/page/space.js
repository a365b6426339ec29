// The membrane, the wanted shape, the supports and the ground in space; drawn when something changed, not sixty times a second.

const ELEVATION = 26; // degrees, as in picture.png
const OPENING = 20; // degrees from top to bottom: lines that run off converge a little, nothing is distorted
const SEEN = 2000; // points of the wanted shape that the first view has to hold, at most
const MOST_SIDES = 400000; // of faces: more would be a grey veil
const MARGIN = 0.84; // share of the canvas that everything takes, beside numbers, buttons and legend
const ASIDE = 55; // pixels at least, on either side, for the numbers

class Space {
  constructor(canvas, labels, record) {
    Object.assign(this, { canvas, labels, record, waiting: false, moved: false });
    // what was drawn is kept, so that the page prints
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(OPENING, 1, 0.01 * record.size, 40 * record.size);
    this.camera.up.set(0, 0, 1);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { minDistance: 0.1 * record.size, maxDistance: 10 * record.size });
    this.controls.addEventListener("start", () => (this.moved = true));
    this.controls.addEventListener("change", () => this.redraw());
    canvas.addEventListener("webglcontextrestored", () => this.redraw());
    // the sun comes from the upper left; most light comes from everywhere, so that colours keep their meaning
    const sun = new THREE.DirectionalLight("white", 0.6 * Math.PI);
    sun.position.set(-0.55, -0.25, 0.8);
    this.scene.add(sun, new THREE.AmbientLight("white", 0.5 * Math.PI));
    this.addSurfaces();
    this.addLines();
    const label = (text, style) => this.label(text, style);
    this.struts = new Struts(this.scene, record, label);
    this.ground = new Ground(this.scene, record, label);
    this.frame();
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    this.resize();
  }

  addSurfaces() {
    const { faces, target, vertices, colours } = this.record;
    const triangles = [];
    const sides = new Map();
    for (let f = 0; f < faces.length; f += 4) {
      const corners = [...faces.slice(f, f + 4)].filter((vertex) => vertex >= 0);
      triangles.push(...corners.slice(0, 3));
      if (corners.length === 4) triangles.push(corners[0], corners[2], corners[3]);
      if (faces.length > MOST_SIDES) continue;
      corners.forEach((one, i) => {
        const other = corners[(i + 1) % corners.length];
        sides.set(Math.min(one, other) * vertices + Math.max(one, other), [one, other]);
      });
    }
    const index = new THREE.BufferAttribute(new Uint32Array(triangles), 1);
    const surface = (positions) => {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
      geometry.setAttribute("uv", new THREE.BufferAttribute(new Float32Array(2 * vertices).fill(0.5), 2));
      geometry.setIndex(index);
      geometry.computeVertexNormals();
      return geometry;
    };
    const rgba = new Uint8Array(256 * 4).fill(255);
    for (let i = 0; i < 256; i++) rgba.set(colours.subarray(3 * i, 3 * i + 3), 4 * i);
    const map = new THREE.DataTexture(rgba, 256, 1);
    Object.assign(map, { colorSpace: THREE.SRGBColorSpace, magFilter: THREE.LinearFilter, needsUpdate: true });
    // lines that lie on a surface are nearer than it
    const back = { side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2 };
    this.cloth = new THREE.MeshLambertMaterial({ color: "#eef1f2", ...back });
    this.coloured = new THREE.MeshLambertMaterial({ map, ...back });
    this.membrane = new THREE.Mesh(surface(target.slice()), this.coloured);
    this.wanted = new THREE.Mesh(surface(target), new THREE.MeshLambertMaterial({ color: "#e3cfa4", ...back }));
    const threads = new THREE.BufferGeometry();
    threads.setAttribute("position", this.membrane.geometry.getAttribute("position"));
    threads.setIndex(new THREE.BufferAttribute(new Uint32Array([...sides.values()].flat()), 1));
    const faint = new THREE.LineBasicMaterial({ color: "black", transparent: true, opacity: 0.13 });
    this.threads = new THREE.LineSegments(threads, faint);
    for (const moving of [this.membrane, this.threads]) moving.frustumCulled = false; // its bounds change with the step
    this.scene.add(this.membrane, this.wanted, this.threads);
  }

  addLines() {
    const wide = (width) => {
      const line = new THREE.LineSegments2(new THREE.LineSegmentsGeometry(), new THREE.LineMaterial({ linewidth: width }));
      line.frustumCulled = false;
      this.scene.add(line);
      return line;
    };
    [this.held, this.cables, this.slices] = [wide(2.5), wide(4.5), wide(1.2)];
    this.slices.geometry.setPositions(this.record.slices);
    Object.assign(this.slices.material, { transparent: true, opacity: 0.8 });
  }

  label(text, style) {
    const element = document.createElement("span");
    element.textContent = text;
    element.className = style;
    this.labels.append(element);
    return element;
  }

  // Colours of the page's style sheet, which knows light and dark.
  paint(style) {
    const colour = (name) => style.getPropertyValue(name).trim();
    this.renderer.setClearColor(colour("--paper"));
    this.ground.paint(colour);
    this.held.material.color.set(colour("--held"));
    this.slices.material.color.set(colour("--slices"));
    this.cables.material.color.set(colour("--cable"));
    this.struts.paint(colour);
  }

  // Show a step in a mode; `top` is the distance at the dark end of the colours, `vertex` the support that is chosen.
  show({ mode, step, sliced, top, vertex }) {
    const { positions, distance } = this.record.shape(step);
    const { geometry } = this.membrane;
    geometry.getAttribute("position").copyArray(positions).needsUpdate = true;
    const place = geometry.getAttribute("uv");
    distance.forEach((value, v) => place.setX(v, Math.min(1, value / top) * (255 / 256) + 0.5 / 256));
    place.needsUpdate = true;
    geometry.computeVertexNormals();
    this.membrane.material = mode === "error" ? this.coloured : this.cloth;
    this.membrane.visible = this.threads.visible = mode !== "target";
    this.wanted.visible = mode === "target";
    this.slices.visible = sliced || mode === "target";
    const on = mode === "target" ? this.record.target : positions;
    for (const [line, edges] of [[this.held, this.record.held], [this.cables, this.record.cables]]) {
      line.visible = edges.length > 0;
      line.geometry.setPositions([...edges].flatMap((v) => [...on.subarray(3 * v, 3 * v + 3)]));
    }
    this.struts.show(step, vertex, positions, this.canvas.clientWidth * this.canvas.clientHeight);
    this.redraw();
  }

  // What a view of everything holds: the corners of the ground, the top of the upright, the wanted shape, the supports.
  everything() {
    const { low, high, ground, target, vertices, last } = this.record;
    const found = [low, high].flatMap((x) => [low, high].map((y) => new THREE.Vector3(x[0], y[1], ground)));
    const stride = Math.ceil(vertices / SEEN);
    for (let v = 0; v < vertices; v += stride) found.push(new THREE.Vector3(...target.subarray(3 * v, 3 * v + 3)));
    for (const { head, end } of this.record.supports(last)) found.push(new THREE.Vector3(...head), new THREE.Vector3(...end));
    return found;
  }

  // Look at everything from an azimuth and an elevation, degrees.
  frame(azimuth = this.record.turn, elevation = ELEVATION) {
    const [turn, rise] = [azimuth, elevation].map((angle) => (angle * Math.PI) / 180);
    const towards = new THREE.Vector3(Math.cos(turn) * Math.cos(rise), Math.sin(turn) * Math.cos(rise), Math.sin(rise));
    const right = new THREE.Vector3(-Math.sin(turn), Math.cos(turn), 0);
    const up = towards.clone().cross(right);
    const steep = Math.tan((OPENING * Math.PI) / 360);
    const spread = [steep * this.camera.aspect, steep];
    const margins = [Math.min(MARGIN, 1 - (2 * ASIDE) / this.canvas.parentElement.clientWidth), MARGIN];
    const points = this.everything();
    const centre = new THREE.Vector3();
    let distance = 3 * this.record.size;
    // what is near takes more room than what is far, so middle and distance are found together; four rounds settle them
    for (let round = 0; round < 4; round++) {
      const seen = points.map((point) => {
        const offset = point.clone().sub(centre);
        const depth = distance - offset.dot(towards);
        return [offset.dot(right) / depth / spread[0], offset.dot(up) / depth / spread[1]];
      });
      const end = (axis, pick) => seen.reduce((most, place) => pick(most, place[axis]), seen[0][axis]);
      const ends = [0, 1].map((axis) => [end(axis, Math.min), end(axis, Math.max)]);
      centre.addScaledVector(right, 0.5 * (ends[0][0] + ends[0][1]) * spread[0] * distance);
      centre.addScaledVector(up, 0.5 * (ends[1][0] + ends[1][1]) * spread[1] * distance);
      distance *= Math.max(...ends.map(([least, most], axis) => (most - least) / 2 / margins[axis]));
    }
    this.controls.target.copy(centre);
    this.camera.position.copy(centre).addScaledVector(towards, distance);
    this.controls.update();
    this.redraw();
  }

  // Turn by degrees, for the keyboard.
  turn(around, upward) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const azimuth = Math.atan2(offset.y, offset.x) + (around * Math.PI) / 180;
    const rise = Math.asin(offset.z / offset.length()) + (upward * Math.PI) / 180;
    const elevation = Math.max(-1.5, Math.min(1.55, rise));
    const flat = Math.cos(elevation) * offset.length();
    offset.set(Math.cos(azimuth) * flat, Math.sin(azimuth) * flat, Math.sin(elevation) * offset.length());
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.moved = true;
    this.redraw();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (!this.moved) this.frame();
    this.draw(); // at once: resizing has emptied the canvas
  }

  // Pixels of a place.
  pixel(point) {
    const seen = point.clone().project(this.camera);
    return [((seen.x + 1) / 2) * this.canvas.clientWidth, ((1 - seen.y) / 2) * this.canvas.clientHeight];
  }

  // The vertex of the support that is seen within `reach` pixels of a point of the canvas, the nearest.
  pick(x, y, reach) {
    let [best, found] = [reach, null];
    for (const { support, head, end } of this.struts.named) {
      const [[ax, ay], [bx, by]] = [this.pixel(head), this.pixel(end)];
      const square = (bx - ax) ** 2 + (by - ay) ** 2;
      const share = square ? Math.max(0, Math.min(1, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / square)) : 0;
      const away = Math.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay));
      if (away < best) [best, found] = [away, support.vertex];
    }
    return found;
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.waiting = false;
    this.camera.updateMatrixWorld();
    const move = (element, point, aside = [0, 0]) => {
      const [x, y] = this.pixel(point);
      element.style.transform = `translate(${(x + aside[0]).toFixed(1)}px, ${(y + aside[1]).toFixed(1)}px)`;
    };
    this.ground.place(this.camera.position, (point) => this.pixel(point), move);
    for (const { label, head } of this.struts.named) if (label) move(label, head, [0, -14]);
    this.renderer.render(this.scene, this.camera);
  }
}
