// The content of the page as arrays and functions: shapes, supports and figures of each step.
"use strict";

const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;

// A figure as people read it: four digits that count, a power of ten where it is very large or small, a proper minus.
function shown(value, digits = 4) {
  if (value === null || value === undefined) return "\u2013";
  const round = Number(value.toPrecision(digits));
  const plain = round === 0 || (Math.abs(round) >= 1e-4 && Math.abs(round) < 1e6);
  return String(plain ? round : round.toExponential()).replace("e+", "e").replaceAll("-", "\u2212");
}

class Record {
  constructor(content) {
    Object.assign(this, content);
    this.target = new Float32Array(bytes(content.target));
    this.vertices = this.target.length / 3;
    this.faces = new Int32Array(bytes(content.faces));
    this.slices = new Float32Array(bytes(content.slices));
    this.colours = new Uint8Array(bytes(content.colours));
    this.held = new Int32Array(bytes(content.held));
    this.points = new Int32Array(bytes(content.points));
    this.cables = new Int32Array(bytes(content.cables));
    this.offsets = new Int16Array(bytes(content.offsets));
    this.heads = new Int32Array(bytes(content.heads));
    this.forces = new Float32Array(bytes(content.forces));
    this.last = this.steps.length - 1;
    this.size = Math.hypot(...this.high.map((high, axis) => high - this.low[axis]));
    this.known = new Map();
  }

  // Positions and distances of a step: the wanted shape plus whole numbers of its unit.
  shape(step) {
    const count = 3 * this.vertices;
    const unit = this.unit[step];
    const positions = new Float32Array(count);
    const distance = new Float32Array(this.vertices);
    for (let i = 0; i < count; i++) positions[i] = this.target[i] + unit * this.offsets[step * count + i];
    for (let v = 0; v < this.vertices; v++) {
      const i = step * count + 3 * v;
      distance[v] = unit * Math.hypot(this.offsets[i], this.offsets[i + 1], this.offsets[i + 2]);
    }
    return { positions, distance };
  }

  // Root mean square of the distance over the free vertices, metres; the fixed ones are where they are wanted.
  rms(distance) {
    let sum = 0;
    for (const value of distance) sum += value * value;
    return Math.sqrt(sum / this.free);
  }

  // Largest distance at a step, or at any; below round-off there is one colour, not a pattern.
  top(step) {
    const largest = (one) => this.shape(one).distance.reduce((most, value) => Math.max(most, value), 1e-9 * this.size);
    if (step !== undefined) return largest(step);
    this.highest ??= this.steps.reduce((most, _, one) => Math.max(most, largest(one)), 0);
    return this.highest;
  }

  // Supports of a step as masts, tie-downs and stays (relax/design/masts.py), ascending by vertex.
  supports(step) {
    if (!this.known.has(step)) {
      const begin = this.counts.slice(0, step).reduce((sum, count) => sum + count, 0);
      const { positions } = this.shape(step);
      const found = [];
      for (let i = begin; i < begin + this.counts[step]; i++) {
        const three = (values, index) => [...values.subarray(3 * index, 3 * index + 3)];
        found.push(this.support(this.heads[i], three(positions, this.heads[i]), three(this.forces, i)));
      }
      this.known.set(step, found);
    }
    return this.known.get(step);
  }

  support(vertex, head, force) {
    const [x, y, z] = force;
    const magnitude = Math.hypot(x, y, z);
    let rise = head[2] - this.ground;
    if (Math.abs(rise) < 1e-6 * this.size) rise = 0; // a head on the ground, but for the round-off of 32 bits
    // arccos of a rounded cosine would lose the small angles
    const lean = (Math.atan2(Math.hypot(x, y), Math.abs(z)) * 180) / Math.PI;
    if (z === 0 || rise < 0) {
      const end = head.map((value, axis) => value + (this.arrow * force[axis]) / magnitude);
      return { vertex, kind: "stay", head, force, magnitude, lean, foot: null, length: null, end, whole: false };
    }
    const run = force.map((value) => (-value * rise) / z);
    const foot = head.map((value, axis) => value + run[axis]);
    const share = this.inside(head, run);
    const end = head.map((value, axis) => value + share * run[axis]);
    const kind = z > 0 ? "mast" : "tie-down";
    return { vertex, kind, head, force, magnitude, lean, foot, length: Math.hypot(...run), end, whole: share === 1 };
  }

  // The share of the way to a foot that stays in the room, in plan: one flat mast would shrink all the rest.
  inside(head, run) {
    const shares = [0, 1].map((axis) => {
      if (run[axis] === 0) return 1;
      return (this.room[run[axis] > 0 ? 1 : 0][axis] - head[axis]) / run[axis];
    });
    return Math.min(1, ...shares.map((share) => Math.max(0, share)));
  }

  // A place as the files have it, metres: digits as the size of the scene asks for, so that round-off stays out.
  place(point) {
    const digits = Math.max(1, 4 - Math.floor(Math.log10(this.size)));
    const texts = point.map((value, axis) => (value + this.origin[axis]).toFixed(digits).replace(/^-(0\.?0*)$/, "$1"));
    return `(${texts.join(", ").replaceAll("-", "\u2212")}) m`;
  }
}
