"use strict";

// Replay of modules and box: a parallel projection on a 2-D canvas, no WebGL, no network.

const plan = JSON.parse(document.getElementById("replay-data").textContent);
const canvas = document.getElementById("replay");
const slider = document.getElementById("replay-time");
const label = document.getElementById("replay-label");
const button = document.getElementById("replay-play");
const speed = document.getElementById("replay-speed");
let azimuth = -62, elevation = 20, zoom = 1, playing = false, before = 0;

const axes = () => {
  const a = azimuth * Math.PI / 180, e = elevation * Math.PI / 180;
  return [
    [-Math.sin(a), Math.cos(a), 0],
    [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)],
    [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)],
  ];
};
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const middle = [0, 1, 2].map((i) => (plan.lower[i] + plan.upper[i]) / 2);
const extent = Math.max(...[0, 1, 2].map((i) => plan.upper[i] - plan.lower[i]));

function corners(low, high) {
  const found = [];
  for (const x of [low[0], high[0]]) for (const y of [low[1], high[1]])
    for (const z of [low[2], high[2]]) found.push([x, y, z]);
  return found;
}
const FACES = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];

function frameAt(time) {
  const t = plan.time;
  let low = 0, high = t.length - 1;
  while (high - low > 1) {
    const half = (low + high) >> 1;
    if (t[half] <= time) low = half; else high = half;
  }
  const share = t[high] > t[low] ? Math.min(Math.max((time - t[low]) / (t[high] - t[low]), 0), 1) : 0;
  const mix = (a, b) => a.map((v, i) => v + share * (b[i] - v));
  return {
    box: mix(plan.box[low], plan.box[high]),
    joints: plan.joints[low].map((row, m) => row.map((p, j) => mix(p, plan.joints[high][m][j]))),
    boxMode: plan.boxMode[low],
    mode: plan.mode[low],
    stage: (plan.stages.find(([, a, b]) => time >= a - 1e-9 && time <= b + 1e-9) || [""])[0],
  };
}

function draw() {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const c = canvas.getContext("2d");
  c.scale(ratio, ratio);
  c.clearRect(0, 0, width, height);
  const view = axes(), scale = zoom * 0.8 * Math.min(width, height * 1.3) / extent;
  const at = (p) => {
    const q = p.map((v, i) => v - middle[i]);
    return [width / 2 + scale * dot(view[0], q), height / 2 - scale * dot(view[1], q)];
  };
  const polygon = (points, fill, stroke, dash = []) => {
    c.beginPath();
    points.map(at).forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
    c.closePath();
    if (fill) { c.fillStyle = fill; c.fill(); }
    if (stroke) { c.setLineDash(dash); c.strokeStyle = stroke; c.lineWidth = 1; c.stroke(); c.setLineDash([]); }
  };
  const block = (low, high, fill, stroke, dash) => {
    const p = corners(low, high), centre = [0, 1, 2].map((i) => (low[i] + high[i]) / 2);
    for (const face of FACES) {
      const mid = [0, 1, 2].map((i) => face.reduce((s, k) => s + p[k][i], 0) / 4 - centre[i]);
      if (dot(mid, view[2]) > 0) polygon(face.map((k) => p[k]), fill, stroke, dash);
    }
  };
  const frame = frameAt(Number(slider.value));
  for (const [low, high] of plan.ground)
    polygon([low, [high[0], low[1], low[2]], [high[0], high[1], low[2]], [low[0], high[1], low[2]]], "rgba(143,163,184,.22)", "rgba(143,163,184,.6)");
  for (const [low, high] of plan.regions) block(low, high, null, "rgba(143,163,184,.35)");
  for (const [low, high] of plan.parked) block(low, high, "rgba(105,117,134,.5)", "#1F2933");
  const half = plan.size.map((s) => s / 2);
  const round = (p) => [p.map((v, i) => v - half[i]), p.map((v, i) => v + half[i])];
  const things = [{
    depth: dot(frame.box, view[2]),
    paint: () => block(...round(frame.box), "rgba(176,144,106,.75)", "#1F2933"),
  }];
  frame.joints.forEach((points, m) => {
    for (let j = 0; j + 1 < points.length; j += 1) {
      const a = points[j], b = points[j + 1];
      things.push({
        depth: dot([0, 1, 2].map((i) => (a[i] + b[i]) / 2), view[2]),
        paint: () => {
          const [x0, y0] = at(a), [x1, y1] = at(b);
          c.strokeStyle = plan.colors[m];
          c.lineWidth = Math.max(2, 2 * plan.radius * scale);
          c.lineCap = "round";
          c.beginPath(); c.moveTo(x0, y0); c.lineTo(x1, y1); c.stroke();
        },
      });
    }
  });
  for (const anchor of plan.anchors)
    things.push({
      depth: dot(anchor, view[2]),
      paint: () => {
        const [x, y] = at(anchor);
        c.fillStyle = "#697586";
        c.beginPath(); c.arc(x, y, Math.max(3, 1.4 * plan.radius * scale), 0, 2 * Math.PI); c.fill();
      },
    });
  things.sort((a, b) => a.depth - b.depth).forEach((thing) => thing.paint());
  block(...round(plan.goal), null, "#C0392B", [4, 3]);
  label.textContent = `${Number(slider.value).toFixed(2)} s · ${frame.stage} · box ${plan.boxModes[frame.boxMode]} · `
    + plan.names.map((name, m) => `${name} ${plan.modes[frame.mode[m]]}`).join(", ");
}

function tick(now) {
  if (!playing) return;
  const end = plan.time[plan.time.length - 1];
  const next = Number(slider.value) + Number(speed.value) * (now - before) / 1000;
  before = now;
  slider.value = next >= end ? end : next;
  if (next >= end) { playing = false; button.textContent = "Play"; }
  draw();
  if (playing) requestAnimationFrame(tick);
}

button.addEventListener("click", () => {
  playing = !playing;
  button.textContent = playing ? "Pause" : "Play";
  if (playing) {
    if (Number(slider.value) >= plan.time[plan.time.length - 1]) slider.value = 0;
    before = performance.now();
    requestAnimationFrame(tick);
  }
});
slider.addEventListener("input", draw);
let dragged = null;
canvas.addEventListener("pointerdown", (e) => { dragged = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
canvas.addEventListener("pointermove", (e) => {
  if (!dragged) return;
  azimuth -= 0.4 * (e.clientX - dragged[0]);
  elevation = Math.min(Math.max(elevation + 0.4 * (e.clientY - dragged[1]), -10), 90);
  dragged = [e.clientX, e.clientY];
  draw();
});
canvas.addEventListener("pointerup", () => { dragged = null; });
canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom *= Math.exp(-0.001 * e.deltaY); draw(); }, { passive: false });
slider.max = plan.time[plan.time.length - 1];
new ResizeObserver(draw).observe(canvas);
draw();
