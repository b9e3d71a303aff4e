"use strict";

// Charts over the instants. Names from the spec reach the page as text only, never as markup.

const escapeHover = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;");

function roundTicks(rounds) {
  const stride = Math.ceil(rounds.length / 10);
  const shown = rounds.filter((_, i) => i % stride === 0);
  return {
    tickvals: shown.map(([, first, last]) => (first + last) / 2),
    ticktext: shown.map(([number]) => String(number)),
  };
}

function chartLayout(plan, colors, title, top) {
  const axis = {
    color: colors.muted, gridcolor: colors.grid, zeroline: false, fixedrange: false,
    tickfont: { size: 11 }, title: { font: { size: 12, color: colors.ink }, standoff: 6 },
  };
  const borders = plan.rounds.slice(1).map(([, first]) => ({
    type: "line", x0: first - 0.5, x1: first - 0.5, y0: 0, y1: 1, yref: "paper", layer: "below",
    line: { color: colors.grid, width: 1 },
  }));
  return {
    margin: { l: 52, r: 8, t: 8, b: 38 },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: "system-ui, sans-serif", color: colors.ink },
    showlegend: false, hovermode: "closest",
    // A finger on a chart scrolls the page.
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
    hoverlabel: { bgcolor: colors.raised, bordercolor: colors.line, font: { color: colors.ink } },
    xaxis: {
      ...axis, ...roundTicks(plan.rounds), showgrid: false, ticks: "",
      range: [-0.5, plan.instants.label.length - 0.5],
      title: { ...axis.title, text: "round" },
    },
    yaxis: { ...axis, range: [0, top], title: { ...axis.title, text: title } },
    shapes: borders,
  };
}

const CHART_OPTIONS = { responsive: true, displaylogo: false, displayModeBar: false };

// The place of a chart with its heading, and a function that draws it there. All places are made
// before any chart is drawn, because their number decides how wide each one is. `pick` is called
// with the instant of a clicked point.
function addChart(home, heading, note, traces, layout, pick) {
  const block = document.createElement("div");
  const title = document.createElement("h3");
  title.textContent = heading;
  const small = document.createElement("small");
  small.textContent = note;
  title.append(small);
  const chart = document.createElement("div");
  chart.className = "chart";
  block.append(title, chart);
  home.append(block);
  return () => {
    Plotly.newPlot(chart, traces, layout, CHART_OPTIONS);
    chart.on("plotly_click", (event) => pick(Math.round(event.points[0].x)));
  };
}

const finite = (values) => values.filter((v) => v !== null);

function limbChart(plan, colors, limb, what, pick) {
  const value = limb[what.value];
  const failure = limb[what.failure];
  const k = value.map((_, i) => i);
  const hover = plan.instants.label.map((label, i) => escapeHover(what.hover(limb, i, label)));
  const step = (y, name, line) => ({
    x: k, y, name, mode: "lines", hoverinfo: "skip", line: { shape: "hvh", ...line },
  });
  const traces = [
    step(failure, "limit", { color: colors.failure, width: 1.8, dash: "dash" }),
    step(limb[what.planned], "planned limit", { color: colors.required, width: 1.1 }),
    {
      x: k, y: value, mode: k.length > 200 ? "lines" : "lines+markers", text: hover,
      hovertemplate: "%{text}<extra></extra>",
      line: { color: limb.color, width: 1.8 }, marker: { size: 4, color: limb.color },
    },
  ];
  const layout = chartLayout(plan, colors, what.axis, 1.08 * what.top);
  for (const [first, last] of limb.lifted) {
    layout.shapes.push({
      type: "rect", x0: first - 0.5, x1: last + 0.5, y0: 0, y1: 1, yref: "paper", layer: "below",
      fillcolor: colors.shade, line: { width: 0 },
    });
  }
  const worst = value.indexOf(Math.max(...value));
  return addChart(what.home, limb.name, what.note(limb, worst), traces, layout, pick);
}

function limbCharts(plan, colors, pick) {
  const highest = (names) => Math.max(...plan.limbs.flatMap((l) => names.flatMap((n) => finite(l[n]))));
  const torque = {
    home: document.getElementById("torque-charts"), value: "torque",
    axis: [...new Set(plan.limbs.flatMap((l) => l.unit))].sort().reverse().join(", "),
    failure: "torque_limit", planned: "torque_planned", top: highest(["torque", "torque_limit"]),
    note: (l, k) => `max ${l.torque[k].toFixed(1)} ${l.unit[k]}, ${l.joint[k]}: ${plan.instants.label[k]}`,
    hover: (l, k, label) => `${label}: ${l.torque[k].toFixed(2)} of ${l.torque_limit[k]} ${l.unit[k]}, ${l.joint[k]}`,
  };
  const friction = {
    home: document.getElementById("friction-charts"), axis: "μ<sub>c</sub>", value: "mu_critical",
    failure: "mu", planned: "mu_planned", top: highest(["mu_critical", "mu"]),
    note: (l, k) => `max ${l.mu_critical[k].toFixed(2)}: ${plan.instants.label[k]}`,
    hover: (l, k, label) => `${label}: ${l.mu_critical[k].toFixed(3)} of ${l.mu[k]}`,
  };
  return [torque, friction].flatMap(
    (what) => plan.limbs.map((limb) => limbChart(plan, colors, limb, what, pick)));
}

function safetyCharts(plan, colors, pick) {
  const home = document.getElementById("safety-charts");
  const { label, lifted } = plan.instants;
  const paint = lifted.map((bits) => {
    const limb = bits.indexOf("1");
    return limb < 0 ? colors.paper : plan.limbs[limb].color;
  });
  const edge = paint.map((color) => (color === colors.paper ? colors.ink : color));
  const k = label.map((_, i) => i);
  const kinds = [
    ["Sτ, torque", "S<sub>τ</sub>", plan.instants.safety_torque, plan.asked.torque],
    ["Sμ, friction", "S<sub>μ</sub>", plan.instants.safety_friction, plan.asked.friction],
  ];
  return kinds.map(([heading, axis, values, asked]) => {
    const known = finite(values);
    const least = known.length ? Math.min(...known) : null;
    const sorted = [...known].sort((a, b) => a - b);
    // Of few instants all are shown, of many the highest hundredth runs off the top
    const usual = sorted.length ? sorted[Math.ceil(0.99 * (sorted.length - 1))] : asked;
    const level = (y, color, dash) => ({
      x: [-0.5, k.length - 0.5], y: [y, y], mode: "lines", hoverinfo: "skip",
      line: { color, width: 1.6, dash },
    });
    const traces = [
      level(asked, colors.required, "solid"),
      level(1, colors.failure, "dash"),
      {
        x: k, y: values, mode: "lines+markers", line: { color: colors.muted, width: 1 },
        marker: { size: k.length > 200 ? 4 : 6, color: paint, line: { color: edge, width: 1 } },
        text: label.map((text, i) => escapeHover(
          `${text}: ${values[i] === null ? "no load" : values[i].toFixed(3)}`)),
        hovertemplate: "%{text}<extra></extra>",
      },
    ];
    const where = least === null ? "no load" : `least ${least.toFixed(2)}: ${label[values.indexOf(least)]}`;
    const layout = chartLayout(plan, colors, axis, 1.15 * Math.max(usual, asked, 1));
    return addChart(home, heading, `${where}; asked ${asked}`, traces, layout, pick);
  });
}

function studyChart(plan, colors) {
  const { study } = plan;
  if (!study) return;
  const [first, second] = study.axes;
  const rows = second ? second.values : [0];
  const z = rows.map((_, j) => first.values.map((_, i) => study.label[i][j]));
  const text = rows.map((_, j) => first.values.map((_, i) => {
    const said = study.detail[i * rows.length + j];
    const wrapped = escapeHover(said).replace(/(.{60}\S*)\s/g, "$1<br>");
    return `${study.labels[study.label[i][j]]}${said ? `<br>${wrapped}` : ""}`;
  }));
  const count = study.labels.length;
  const scale = study.colors.flatMap((color, i) => [[i / count, color], [(i + 1) / count, color]]);
  const traces = [{
    type: "heatmap", x: first.values, y: second ? second.values : [""], z, text, xgap: 1, ygap: 1,
    zmin: -0.5, zmax: count - 0.5, colorscale: scale, showscale: false,
    hovertemplate: "%{text}<extra></extra>",
  }];
  study.labels.forEach((name, i) => traces.push({
    x: [null], y: [null], mode: "markers", name, showlegend: true,
    marker: { symbol: "square", size: 14, color: study.colors[i] },
  }));
  const own = [first.own, second ? second.own : ""];
  if (own[0] !== null && own[1] !== null) {
    traces.push({
      x: [own[0]], y: [own[1]], mode: "markers", name: "this plan", hoverinfo: "name",
      marker: { symbol: "star", size: 17, color: "#fff", line: { color: "#1f2933", width: 1.5 } },
    });
  }
  const layout = chartLayout(plan, colors, "", 1);
  const axis = (label) => ({
    color: colors.muted, gridcolor: colors.grid, zeroline: false,
    title: { text: escapeHover(label), font: { size: 13, color: colors.ink } },
  });
  layout.margin = { l: second ? 60 : 20, r: 10, t: 10, b: 50 };
  layout.xaxis = axis(first.label);
  layout.yaxis = second ? axis(second.label) : { ...axis(""), showticklabels: false };
  layout.shapes = [];
  layout.showlegend = true;
  layout.legend = { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 };
  const home = document.getElementById("study-chart");
  if (!second) home.style.height = "240px";
  Plotly.newPlot(home, traces, layout, CHART_OPTIONS);
}

function drawCharts(plan, colors, pick) {
  for (const chart of document.querySelectorAll(".chart, #study-chart")) Plotly.purge(chart);
  for (const id of ["safety-charts", "torque-charts", "friction-charts"]) {
    document.getElementById(id).replaceChildren();
  }
  const drawings = [...safetyCharts(plan, colors, pick), ...limbCharts(plan, colors, pick)];
  drawings.forEach((draw) => draw());
  studyChart(plan, colors);
}
