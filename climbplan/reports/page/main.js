"use strict";

const byId = (id) => document.getElementById(id);

// The embedded integers as points in metres.
function unpack(data) {
  const { length, angle, force } = data.unit;
  const limbs = data.limbs.length;
  const vectors = (flat, unit) => {
    const rows = [];
    for (let i = 0; i < flat.length; i += 3) {
      rows.push([flat[i] * unit, flat[i + 1] * unit, flat[i + 2] * unit]);
    }
    return rows;
  };
  const grouped = (rows, size) => {
    const groups = [];
    for (let i = 0; i < rows.length; i += size) groups.push(rows.slice(i, i + size));
    return groups;
  };
  const poses = (from) => ({
    com: vectors(from.com, length),
    rpy: vectors(from.rpy, angle),
    joints: grouped(grouped(vectors(from.joints, length), 3), limbs),
    contact: from.contact.map((bits) => [...bits].map((bit) => bit === "1")),
  });
  return {
    ...data,
    path: vectors(data.scene.path, length),
    footholds: vectors(data.scene.footholds, length).map((point, i) => [i % limbs, point]),
    replay: { ...data.replay, ...poses(data.replay) },
    instants: {
      ...data.instants,
      ...poses(data.instants),
      normal: grouped(vectors(data.instants.normal, 1), limbs),
      force: grouped(vectors(data.instants.force, force), limbs),
    },
  };
}

function readColors() {
  const style = getComputedStyle(document.documentElement);
  const names = ["paper", "raised", "ink", "muted", "line", "grid", "required", "shade", "body",
    "edge", "highlight", "failure", "force", "surface", "obstacle"];
  return Object.fromEntries(names.map((n) => [n, style.getPropertyValue(`--${n}`).trim()]));
}

// Forces of one instant at the toes drawn; limbs in the air have none.
function contactsAt(plan, k, toes, standing) {
  if (k < 0) return [];
  const scale = plan.scene.force_scale;
  const found = [];
  plan.limbs.forEach((limb, i) => {
    if (!plan.instants.contact[k][i] || !standing[i]) return;
    const force = plan.instants.force[k][i];
    const normal = plan.instants.normal[k][i];
    found.push({
      toe: toes[i], tip: add(toes[i], force, scale), normal,
      press: plan.scene.gripper > 0 ? 0 : scale * dot(force, normal), // grips have no cone
      mu: limb.mu[k], muPlanned: limb.mu_planned[k],
    });
  });
  return found;
}

// The state at a time, frames interpolated linearly.
function stateAt(plan, time) {
  const { replay } = plan;
  let low = 0;
  let high = replay.time.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (replay.time[middle] <= time) low = middle;
    else high = middle;
  }
  const span = replay.time[high] - replay.time[low];
  const share = span > 0 ? Math.max(0, Math.min(1, (time - replay.time[low]) / span)) : 0;
  const mix = (a, b) => a.map((v, i) => v + share * (b[i] - v));
  const nearer = share < 1 ? low : high;
  const joints = replay.joints[low].map((chain, n) => chain.map((p, j) => mix(p, replay.joints[high][n][j])));
  const contact = replay.contact[nearer];
  const instant = replay.instant[nearer];
  return {
    com: mix(replay.com[low], replay.com[high]),
    rpy: mix(replay.rpy[low], replay.rpy[high]),
    joints, contact, instant,
    forces: contactsAt(plan, instant, joints.map((chain) => chain[2]), contact),
  };
}

const shown = (value) => (value === null ? "no load" : value.toFixed(2));

class Player {
  constructor(plan, view) {
    this.plan = plan;
    this.view = view;
    this.end = plan.replay.time[plan.replay.time.length - 1];
    this.time = plan.replay.time[0];
    this.playing = false;
    byId("time").max = this.end;
    byId("play").addEventListener("click", () => this.toggle());
    byId("time").addEventListener("input", (event) => this.seek(Number(event.target.value)));
    byId("replay-view").addEventListener("keydown", (event) => {
      if (event.key !== " ") return;
      event.preventDefault();
      this.toggle();
    });
    const options = { "show-forces": "forces", "show-cones": "cones", "show-holds": "footholds", follow: "follow" };
    for (const [id, name] of Object.entries(options)) {
      const apply = () => {
        view.options[name] = byId(id).checked;
        view.draw();
      };
      byId(id).addEventListener("change", apply);
      apply();
    }
    this.seek(this.time);
  }

  toggle() {
    this.playing = !this.playing;
    if (this.playing && this.time >= this.end) this.time = this.plan.replay.time[0];
    byId("play").textContent = this.playing ? "Pause" : "Play";
    byId("play").setAttribute("aria-pressed", String(this.playing));
    this.last = performance.now();
    if (this.playing) requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    if (!this.playing) return;
    const passed = Math.max(0, Math.min(now - this.last, 250)) / 1000; // a hidden tab does not jump
    this.last = now;
    this.seek(Math.min(this.end, this.time + passed * Number(byId("speed").value)));
    if (this.time >= this.end) this.toggle();
    else requestAnimationFrame((next) => this.tick(next));
  }

  seek(time) {
    this.time = time;
    const state = stateAt(this.plan, time);
    this.view.show(state);
    byId("time").value = time;
    byId("clock").textContent = `${time.toFixed(1)} of ${this.end.toFixed(0)} s`;
    const { instants } = this.plan;
    const k = state.instant;
    byId("replay-phase").textContent = k < 0 ? "start posture" : instants.label[k];
    byId("replay-safety").textContent = k < 0 ? ""
      : `Sτ ${shown(instants.safety_torque[k])}   Sμ ${shown(instants.safety_friction[k])}`;
  }
}

class ForcePanel {
  constructor(plan, view) {
    this.plan = plan;
    this.view = view;
    const last = plan.instants.label.length - 1;
    byId("instant").max = last;
    const here = () => Number(byId("instant").value);
    byId("instant").addEventListener("input", () => this.pick(here()));
    byId("previous").addEventListener("click", () => this.pick(Math.max(0, here() - 1)));
    byId("next").addEventListener("click", () => this.pick(Math.min(last, here() + 1)));
    const least = (values) => {
      const known = finite(values);
      return known.length ? values.indexOf(Math.min(...known)) : 0;
    };
    byId("least-torque").addEventListener("click", () => this.pick(least(plan.instants.safety_torque)));
    byId("least-friction").addEventListener("click", () => this.pick(least(plan.instants.safety_friction)));
    view.options = { forces: true, cones: true, footholds: false, follow: true };
    this.pick(least(plan.instants.safety_torque));
  }

  pick(k) {
    const { instants } = this.plan;
    byId("instant").value = k;
    byId("instant-label").textContent = `${k + 1}: ${instants.label[k]}`;
    const joints = instants.joints[k];
    const contact = instants.contact[k];
    const forces = contactsAt(this.plan, k, joints.map((chain) => chain[2]), contact);
    const pose = { com: instants.com[k], rpy: instants.rpy[k], joints, contact };
    this.view.show({ ...pose, forces, instant: k });
    byId("forces-scale").textContent =
      `Sτ ${shown(instants.safety_torque[k])}   Sμ ${shown(instants.safety_friction[k])}`;
    byId("force-rows").replaceChildren(...this.plan.limbs.map((limb, i) => this.row(limb, i, k)));
  }

  row(limb, i, k) {
    const row = document.createElement("tr");
    const name = document.createElement("td");
    const dotMark = document.createElement("i");
    dotMark.style.background = limb.color;
    name.append(dotMark, limb.name);
    row.append(name);
    const add = (text) => {
      const cell = document.createElement("td");
      cell.textContent = text;
      row.append(cell);
    };
    if (!this.plan.instants.contact[k][i]) {
      row.className = "idle";
      for (const text of ["lifted", "", "", ""]) add(text);
      return row;
    }
    const force = this.plan.instants.force[k][i];
    const press = dot(force, this.plan.instants.normal[k][i]);
    add(press.toFixed(1));
    add(Math.sqrt(Math.max(0, dot(force, force) - press * press)).toFixed(1));
    add(`${limb.mu_critical[k].toFixed(2)} / ${limb.mu[k]}`);
    add(`${limb.torque[k].toFixed(1)} / ${limb.torque_limit[k]}, ${limb.joint[k]}`);
    return row;
  }
}

function start() {
  const plan = unpack(JSON.parse(byId("plan-data").textContent));
  const views = {
    "replay-view": new SceneView(byId("replay-view"), plan),
    "forces-view": new SceneView(byId("forces-view"), plan),
  };
  for (const limb of plan.limbs) {
    const item = document.createElement("li");
    const swatch = document.createElement("i");
    swatch.style.background = limb.color;
    item.append(swatch, limb.name);
    byId("limb-legend").append(item);
  }
  // A tall climb is followed, so that the robot stays large enough to see.
  byId("follow").checked = plan.scene.upper[2] - plan.scene.lower[2] > 2.2;
  for (const bar of document.querySelectorAll(".views")) {
    const view = views[bar.dataset.for];
    bar.addEventListener("click", (event) => {
      const { view: name, zoom } = event.target.dataset;
      if (name) view.look(name);
      if (zoom) view.magnify(Number(zoom));
    });
  }
  let panel = null;
  const paint = () => {
    const colors = readColors();
    for (const view of Object.values(views)) {
      view.colors = colors;
      view.draw();
    }
    drawCharts(plan, colors, (k) => panel.pick(k));
  };
  new Player(plan, views["replay-view"]);
  panel = new ForcePanel(plan, views["forces-view"]);
  paint();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
  // Paper is white, whatever the screen is.
  const printing = (now) => {
    if (!matchMedia("(prefers-color-scheme: dark)").matches) return;
    document.documentElement.toggleAttribute("data-printing", now);
    paint();
  };
  addEventListener("beforeprint", () => printing(true));
  addEventListener("afterprint", () => printing(false));
}

start();
