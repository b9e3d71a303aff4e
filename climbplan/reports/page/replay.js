"use strict";

// Replay of a scene: a parallel projection on a 2-D canvas, no WebGL, no network.

const scene = JSON.parse(document.getElementById("replay-data").textContent);
const canvas = document.getElementById("replay");
const slider = document.getElementById("replay-time");
const label = document.getElementById("replay-label");
const button = document.getElementById("replay-play");
const speed = document.getElementById("replay-speed");
const first = scene.time[0], last = scene.time[scene.time.length - 1];
let azimuth = scene.azimuth, elevation = scene.elevation, zoom = 1, playing = false, before = 0;
// The slider shows the time and is not where it is kept: it rounds what it is given
let time = scene.start;

const axes = () => {
  const a = azimuth * Math.PI / 180, e = elevation * Math.PI / 180;
  return [
    [-Math.sin(a), Math.cos(a), 0],
    [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)],
    [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)],
  ];
};
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const FACES = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
const faded = (color, opacity) => color + Math.round(255 * opacity).toString(16).padStart(2, "0");

function moment(time) {
  const t = scene.time;
  let low = 0, high = t.length - 1;
  while (high - low > 1) {
    const half = (low + high) >> 1;
    if (t[half] <= time) low = half; else high = half;
  }
  if (high && t[high] <= time) low = high;
  const share = t[high] > t[low] ? Math.min(Math.max((time - t[low]) / (t[high] - t[low]), 0), 1) : 0;
  const mix = (a, b) => (Array.isArray(a) ? a.map((v, i) => mix(v, b[i])) : a + share * (b - a));
  return { low, of: (samples) => mix(samples[low], samples[high]) };
}

function cuboid(centre, turned, size) {
  const found = [];
  for (const x of [-0.5, 0.5]) for (const y of [-0.5, 0.5]) for (const z of [-0.5, 0.5]) {
    const own = [x * size[0], y * size[1], z * size[2]];
    found.push(turned.map((row, i) => centre[i] + dot(row, own)));
  }
  return found;
}

function draw() {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const c = canvas.getContext("2d");
  c.scale(ratio, ratio);
  c.clearRect(0, 0, width, height);
  const view = axes(), scale = zoom * 0.6 * Math.min(width, height * 1.3) / scene.extent;
  const now = moment(time), middle = now.of(scene.middle);
  const at = (p) => {
    const q = p.map((v, i) => v - middle[i]);
    return [width / 2 + scale * dot(view[0], q), height / 2 - scale * dot(view[1], q)];
  };
  const polygon = (points, fill, stroke) => {
    c.beginPath();
    points.map(at).forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
    c.closePath();
    if (fill) { c.fillStyle = fill; c.fill(); }
    if (stroke) { c.strokeStyle = stroke; c.lineWidth = 1; c.stroke(); }
  };
  const line = (a, b, color, wide) => {
    const [x0, y0] = at(a), [x1, y1] = at(b);
    c.strokeStyle = color; c.lineWidth = wide; c.lineCap = "round";
    c.beginPath(); c.moveTo(x0, y0); c.lineTo(x1, y1); c.stroke();
  };
  const things = [];
  if (scene.boxes) {
    const centre = now.of(scene.boxes.center), turned = now.of(scene.boxes.rotation);
    scene.boxes.size[now.low].forEach((size, k) => {
      if (!size.some((s) => s > 0)) return;
      const p = cuboid(centre[k], turned[k], size);
      things.push({ depth: dot(centre[k], view[2]), paint: () => {
        for (const face of FACES) {
          const mid = [0, 1, 2].map((i) => face.reduce((s, n) => s + p[n][i], 0) / 4 - centre[k][i]);
          if (dot(mid, view[2]) > 0) polygon(face.map((n) => p[n]), faded(scene.boxes.color[k], 0.8), "rgba(143,163,184,.9)");
        }
      } });
    });
  }
  if (scene.rods)
    now.of(scene.rods.ends).forEach(([a, b], k) => things.push({
      depth: (dot(a, view[2]) + dot(b, view[2])) / 2,
      paint: () => line(a, b, scene.rods.color[k], Math.max(2, 2 * scene.rods.radius[k] * scale)),
    }));
  if (scene.forces) {
    const points = now.of(scene.forces.point);
    scene.forces.arrow[now.low].forEach((arrow, k) => {
      if (!arrow.some((v) => v)) return;
      const toe = points[k], from = toe.map((v, i) => v - arrow[i]);
      things.push({ depth: dot(from, view[2]), paint: () => {
        line(from, toe, scene.forces.color, 2.5);
        const [x0, y0] = at(from), [x1, y1] = at(toe), long = Math.hypot(x1 - x0, y1 - y0) || 1;
        const ux = 8 * (x1 - x0) / long, uy = 8 * (y1 - y0) / long;
        c.fillStyle = scene.forces.color;
        c.beginPath(); c.moveTo(x1, y1); c.lineTo(x1 - ux - uy / 2, y1 - uy + ux / 2);
        c.lineTo(x1 - ux + uy / 2, y1 - uy - ux / 2); c.fill();
      } });
    });
  }
  const foremost = Math.max(...things.map((thing) => thing.depth));
  for (const shape of scene.shapes) {
    // What stands wholly before all that moves, as the front wall of a room, would hide it
    if (Math.min(...shape.vertices.map((p) => dot(p, view[2]))) >= foremost) continue;
    for (const face of shape.faces) polygon(face.map((n) => shape.vertices[n]), faded(shape.color, 0.16 * shape.opacity), null);
    for (const [a, b] of shape.outline) line(shape.vertices[a], shape.vertices[b], "rgba(143,163,184,.75)", 1);
  }
  things.sort((a, b) => a.depth - b.depth).forEach((thing) => thing.paint());
  label.textContent = `${(time - first).toFixed(2)} s of ${(last - first).toFixed(2)} s · ${scene.caption[now.low]}`;
}

function goTo(next) {
  time = next;
  slider.value = time;
  draw();
}

function tick(now) {
  if (!playing) return;
  const next = time + Number(speed.value) * Math.max(now - before, 0) / 1000;
  before = now;
  if (next >= last) { playing = false; button.textContent = "Play"; }
  goTo(Math.min(next, last));
  if (playing) requestAnimationFrame(tick);
}

button.addEventListener("click", () => {
  playing = !playing;
  button.textContent = playing ? "Pause" : "Play";
  if (playing) {
    if (time >= last) goTo(scene.start);
    before = performance.now();
    requestAnimationFrame(tick);
  }
});
slider.addEventListener("input", () => { time = Number(slider.value); draw(); });
let dragged = null;
canvas.addEventListener("pointerdown", (e) => { dragged = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
canvas.addEventListener("pointermove", (e) => {
  if (!dragged) return;
  azimuth -= 0.4 * (e.clientX - dragged[0]);
  elevation = Math.min(Math.max(elevation + 0.4 * (e.clientY - dragged[1]), -10), 90);
  dragged = [e.clientX, e.clientY];
  draw();
});
for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { dragged = null; });
canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom *= Math.exp(-0.001 * e.deltaY); draw(); }, { passive: false });
slider.min = first;
slider.max = last;
slider.value = time;
new ResizeObserver(draw).observe(canvas);
draw();
