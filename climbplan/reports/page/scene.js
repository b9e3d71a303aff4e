"use strict";

// A parallel projection of the climb on a 2-D canvas: no WebGL, so it works in every browser.
// Everything solid is convex, so "a point beyond a face that is turned to the viewer cannot be
// hidden by the solid" gives an exact drawing order without a depth buffer.

const VIEWS = { front: [-90, 0], side: [0, 0], top: [-90, 90] };

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
const mean = (points) => {
  let sum = [0, 0, 0];
  for (const p of points) sum = add(sum, p);
  return sum.map((v) => v / points.length);
};

// Body-to-world rotation R = Rz(yaw) Ry(pitch) Rx(roll), as a function on vectors.
function rotation([roll, pitch, yaw]) {
  const [cr, cp, cy] = [roll, pitch, yaw].map(Math.cos);
  const [sr, sp, sy] = [roll, pitch, yaw].map(Math.sin);
  const rows = [
    [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
    [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
    [-sp, cp * sr, cp * cr],
  ];
  return (v) => rows.map((row) => dot(row, v));
}

// Two unit vectors at right angles to a unit normal.
function across(normal) {
  const i = [0, 1, 2].reduce((a, b) => (Math.abs(normal[b]) < Math.abs(normal[a]) ? b : a));
  const seed = [0, 0, 0];
  seed[i] = 1;
  const first = cross(normal, seed);
  const length = Math.hypot(...first);
  const unit = first.map((v) => v / length);
  return [unit, cross(normal, unit)];
}

class SceneView {
  constructor(canvas, plan) {
    this.canvas = canvas;
    this.plan = plan;
    this.context = canvas.getContext("2d");
    this.state = null;
    this.options = { forces: true, cones: false, footholds: true, follow: false };
    this.zoom = 1;
    this.colors = {};
    this.views = { ...VIEWS, oblique: plan.scene.oblique };
    [this.azimuth, this.elevation] = this.views.oblique;
    const { lower, upper } = plan.scene;
    this.center = mean([lower, upper]);
    this.size = [0, 1, 2].map((i) => upper[i] - lower[i]);
    this.listen();
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  listen() {
    const canvas = this.canvas;
    const held = new Map();
    let spread = 0;
    const apart = () => {
      const [a, b] = [...held.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (held.size === 2) spread = apart();
    });
    canvas.addEventListener("pointermove", (event) => {
      const last = held.get(event.pointerId);
      if (!last) return;
      const now = { x: event.clientX, y: event.clientY };
      held.set(event.pointerId, now);
      if (held.size === 2) {
        const wide = apart();
        if (spread > 0) this.magnify(wide / spread);
        spread = wide;
      } else {
        this.azimuth -= 0.4 * (now.x - last.x);
        this.elevation = Math.max(-90, Math.min(90, this.elevation + 0.4 * (now.y - last.y)));
        this.draw();
      }
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => held.delete(event.pointerId));
    }
    // The wheel scrolls the page unless a modifier says otherwise.
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      this.magnify(Math.exp(-0.002 * event.deltaY));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const turns = { ArrowLeft: [5, 0], ArrowRight: [-5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] };
      const turn = turns[event.key];
      if (turn) {
        this.azimuth += turn[0];
        this.elevation = Math.max(-90, Math.min(90, this.elevation + turn[1]));
        this.draw();
      } else if (event.key === "+" || event.key === "-") {
        this.magnify(event.key === "+" ? 1.25 : 0.8);
      } else {
        return;
      }
      event.preventDefault();
    });
  }

  look(name) {
    [this.azimuth, this.elevation] = this.views[name];
    this.draw();
  }

  magnify(factor) {
    this.zoom = Math.max(0.3, Math.min(12, this.zoom * factor));
    this.draw();
  }

  show(state) {
    this.state = state;
    this.draw();
  }

  // Camera

  aim(width, height) {
    const az = (this.azimuth * Math.PI) / 180;
    const el = (this.elevation * Math.PI) / 180;
    this.right = [-Math.sin(az), Math.cos(az), 0];
    this.up = [-Math.sin(el) * Math.cos(az), -Math.sin(el) * Math.sin(az), Math.cos(el)];
    this.toward = [Math.cos(el) * Math.cos(az), Math.cos(el) * Math.sin(az), Math.sin(el)];
    // Turning must not change the scale: fit the box's widest plan view and its height.
    const around = Math.hypot(this.size[0], this.size[1]);
    const tall = this.options.follow ? Math.min(this.size[2], 1.5) : this.size[2] + 0.3 * around;
    this.scale = this.zoom * Math.min(width / around, height / Math.max(tall, 0.6 * around)) * 0.98;
    this.target = this.center;
    if (this.options.follow && this.state) this.target = this.state.com;
    this.middle = [width / 2, height / 2];
  }

  project(p) {
    const d = add(p, this.target, -1);
    return [
      this.middle[0] + this.scale * dot(d, this.right),
      this.middle[1] - this.scale * dot(d, this.up),
    ];
  }

  depth(p) {
    return dot(p, this.toward);
  }

  facing(normal) {
    return dot(normal, this.toward) > 1e-6;
  }

  // Pens

  trace(points, close) {
    const c = this.context;
    c.beginPath();
    points.forEach((p, i) => {
      const [x, y] = this.project(p);
      if (i) c.lineTo(x, y);
      else c.moveTo(x, y);
    });
    if (close) c.closePath();
  }

  fill(points, color, alpha) {
    this.context.globalAlpha = alpha;
    this.context.fillStyle = color;
    this.trace(points, true);
    this.context.fill();
    this.context.globalAlpha = 1;
  }

  stroke(points, color, width, { alpha = 1, close = false, dash = [] } = {}) {
    const c = this.context;
    c.globalAlpha = alpha;
    c.strokeStyle = color;
    c.lineWidth = width;
    c.lineCap = "round";
    c.lineJoin = "round";
    c.setLineDash(dash);
    this.trace(points, close);
    c.stroke();
    c.setLineDash([]);
    c.globalAlpha = 1;
  }

  disc(point, radius, color, edge) {
    const c = this.context;
    const [x, y] = this.project(point);
    c.beginPath();
    c.arc(x, y, radius, 0, 2 * Math.PI);
    c.fillStyle = color;
    c.fill();
    if (edge) {
      c.strokeStyle = edge;
      c.lineWidth = 1.5;
      c.stroke();
    }
  }

  arrow(from, to, color, width) {
    const [a, b] = [this.project(from), this.project(to)];
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (length < 1) return;
    const u = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
    const head = Math.min(4.2 * width, length);
    const c = this.context;
    c.strokeStyle = c.fillStyle = color;
    c.lineWidth = width;
    c.lineCap = "butt";
    c.beginPath();
    c.moveTo(...a);
    c.lineTo(b[0] - 0.8 * head * u[0], b[1] - 0.8 * head * u[1]);
    c.stroke();
    c.beginPath();
    c.moveTo(...b);
    for (const side of [1, -1]) {
      c.lineTo(b[0] - head * u[0] - side * 0.45 * head * u[1],
               b[1] - head * u[1] + side * 0.45 * head * u[0]);
    }
    c.fill();
  }

  label(text, x, y, align = "left") {
    const c = this.context;
    c.font = "12px system-ui, sans-serif";
    c.textAlign = align;
    c.textBaseline = "middle";
    c.lineWidth = 3;
    c.lineJoin = "round";
    c.strokeStyle = this.colors.raised;
    c.strokeText(text, x, y);
    c.fillStyle = this.colors.muted;
    c.fillText(text, x, y);
  }

  // Scene

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height || !this.state) return;
    if (this.canvas.width !== Math.round(width * ratio)
        || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.context.clearRect(0, 0, width, height);
    this.aim(width, height);
    this.walls(true);
    this.ruler();
    if (this.options.footholds) this.footholds();
    this.things();
    this.walls(false);
    if (this.options.forces || this.options.cones) this.contacts();
  }

  walls(behind) {
    for (const surface of this.plan.scene.surfaces) {
      const strips = surface.patches.length > 1; // a tube: no seams
      for (const patch of surface.patches) {
        if (this.facing(patch.n) !== behind) continue;
        if (behind) this.fill(patch.v, this.colors.surface, 0.22);
        if (strips) this.stroke([patch.v[0], patch.v[1]], this.colors.surface, 1, { alpha: 0.7 });
        if (strips) this.stroke([patch.v[2], patch.v[3]], this.colors.surface, 1, { alpha: 0.7 });
        else this.stroke(patch.v, this.colors.surface, 1, { alpha: behind ? 0.9 : 0.6, close: true });
      }
    }
  }

  // Heights in metres along the leftmost upright edge of the box.
  ruler() {
    if (Math.abs(this.elevation) > 75) return;
    const { lower, upper } = this.plan.scene;
    const corners = [];
    for (const x of [lower[0], upper[0]]) for (const y of [lower[1], upper[1]]) corners.push([x, y]);
    const at = (xy, z) => this.project([...xy, z]);
    const left = corners.reduce((a, b) => (at(b, 0)[0] < at(a, 0)[0] ? b : a));
    this.stroke([[...left, lower[2]], [...left, upper[2]]], this.colors.muted, 1, { alpha: 0.6 });
    const step = this.size[2] > 2.5 ? 0.5 : 0.2;
    for (let n = Math.ceil(lower[2] / step); n * step <= upper[2]; n += 1) {
      const [x, y] = at(left, n * step);
      this.context.fillStyle = this.colors.muted;
      this.context.fillRect(x - 4, y - 0.5, 4, 1);
      const text = (n * step).toFixed(1).replace("-", "−");
      const inside = x < 42; // no room to the left
      this.label(n === 0 ? "0.0 m" : text, inside ? x + 6 : x - 7, y, inside ? "left" : "right");
    }
  }

  footholds() {
    for (const [limb, point] of this.plan.footholds) {
      this.disc(point, 2.6, this.plan.limbs[limb].color);
    }
    this.stroke(this.plan.path, this.colors.muted, 1.2, { alpha: 0.8, dash: [4, 3] });
  }

  // Solids from far to near; every link goes into the layer after the last solid it is not behind.
  things() {
    const solids = this.solids().sort((a, b) => this.depth(a.center) - this.depth(b.center));
    const layers = solids.map(() => []);
    layers.push([]);
    for (const link of this.links()) {
      const middle = mean([link.from, link.to]);
      let layer = 0;
      solids.forEach((solid, i) => {
        if (solid.seen.some((f) => dot(f.n, middle) > f.offset + 1e-9)) layer = i + 1;
      });
      layers[layer].push({ ...link, depth: this.depth(middle) });
    }
    layers.forEach((layer, i) => {
      layer.sort((a, b) => a.depth - b.depth).forEach((link) => this.link(link));
      if (i < solids.length) solids[i].draw();
    });
  }

  solids() {
    const { scene } = this.plan;
    const found = scene.obstacles.filter((o) => o.faces.length).map((obstacle) => {
      const seen = obstacle.faces.filter((f) => this.facing(f.n))
        .map((f) => ({ ...f, offset: dot(f.n, f.v[0]) }));
      const center = mean(obstacle.faces.map((f) => mean(f.v)));
      return { center, seen, draw: () => this.faces(seen, this.colors.obstacle, 0.82) };
    });
    const turn = rotation(this.state.rpy);
    const place = (p) => add(turn(p), this.state.com);
    const seen = scene.hull.map((face) => {
      const v = face.v.map(place);
      const n = turn(face.n);
      return { v, n, offset: dot(n, v[0]) };
    }).filter((f) => this.facing(f.n));
    const ring = scene.ring.map(place);
    found.push({
      center: this.state.com,
      seen,
      draw: () => {
        this.fill(ring, this.colors.body, 0.55);
        this.stroke(ring, this.colors.edge, 1, { close: true, alpha: 0.8 });
        this.faces(seen, this.colors.body, 0.94);
      },
    });
    return found;
  }

  faces(faces, color, alpha) {
    const light = [0.3, -0.4, 0.87];
    for (const face of faces) {
      this.fill(face.v, color, alpha);
      this.fill(face.v, "#000", 0.26 * (1 - Math.abs(dot(face.n, light))));
      this.stroke(face.v, this.colors.edge, 0.8, { close: true, alpha: 0.7 });
    }
  }

  links() {
    const turn = rotation(this.state.rpy);
    const thick = Math.max(3, Math.min(12, 1.3 * this.plan.scene.limb_radius * this.scale));
    const { gripper } = this.plan.scene;
    const found = [];
    this.plan.limbs.forEach((limb, i) => {
      const chain = [add(turn(this.plan.scene.shoulders[i]), this.state.com), ...this.state.joints[i]];
      for (let j = 0; j < 3; j += 1) {
        found.push({
          from: chain[j], to: chain[j + 1], color: limb.color, toe: j === 2,
          width: thick * [1, 0.85, 0.6][j], lifted: !this.state.contact[i],
        });
      }
      if (gripper > 0) {
        const normal = this.plan.instants.normal[Math.max(this.state.instant ?? 0, 0)][i];
        const wrist = chain[chain.length - 1];
        found.push({
          from: wrist, to: add(wrist, normal, -gripper), color: this.colors.muted, toe: false,
          width: 0.4 * thick, lifted: false,
        });
      }
    });
    return found;
  }

  link({ from, to, color, width, toe, lifted }) {
    if (lifted) this.stroke([from, to], this.colors.highlight, width + 9, { alpha: 0.45 });
    this.stroke([from, to], this.colors.edge, width + 1.5);
    this.stroke([from, to], color, width);
    if (toe) this.disc(to, Math.max(3.5, 0.6 * width), lifted ? this.colors.paper : color, this.colors.edge);
  }

  contacts() {
    for (const contact of this.state.forces) {
      if (this.options.cones) this.cone(contact);
    }
    for (const { toe, tip } of this.state.forces) {
      if (this.options.forces) this.arrow(toe, tip, this.colors.force, 2.6);
    }
  }

  // Cut at the height of the normal force: the tip of the force lies in the cut.
  cone({ toe, normal, press, mu, muPlanned }) {
    if (press <= 0) return;
    const center = add(toe, normal, press);
    const [a, b] = across(normal);
    const ring = (radius) => Array.from({ length: 40 }, (_, i) => {
      const t = (2 * Math.PI * i) / 40;
      return add(add(center, a, radius * Math.cos(t)), b, radius * Math.sin(t));
    });
    const outer = ring(mu * press);
    const inner = ring(muPlanned * press);
    outer.forEach((p, i) => this.fill([toe, p, outer[(i + 1) % 40]], this.colors.failure, 0.05));
    this.fill(inner, this.colors.failure, 0.22);
    this.stroke(outer, this.colors.failure, 1.3, { close: true });
    this.stroke(inner, this.colors.failure, 1.1, { close: true, dash: [4, 3] });
  }
}
