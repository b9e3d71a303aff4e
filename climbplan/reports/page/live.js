// The live page: an editor, planning with progress, replays, checks and comparisons.

const el = (id) => document.getElementById(id);
const values = JSON.parse(el("live-data").textContent);
const spec = el("spec"), gutter = el("gutter"), popup = el("completions");
const schemas = new Map(); // by kind; null while it is fetched
let runs = [], shown = null, running = null, opened = "", checkTimer = 0, checkCount = 0, wrongLines = new Set();
let choices = [], chosen = 0, word = "";

async function ask(path, body) {
  const options = body === undefined ? {} : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  const answer = await fetch(path, options);
  if (!answer.ok) throw new Error((await answer.json()).error);
  return answer.headers.get("Content-Type").startsWith("application/json") ? answer.json() : answer.text();
}

const tell = (text) => { el("state").textContent = text; };

// --- the editor ---

function kindOf(text) {
  const found = /^kind:\s*(\w+)/m.exec(text);
  return found && values.kinds.includes(found[1]) ? found[1] : "";
}

function schemaOf(text) {
  const kind = kindOf(text);
  if (!kind) return { properties: { kind: { enum: values.kinds, description: "kind of the spec" } } };
  if (!schemas.has(kind)) {
    schemas.set(kind, null);
    ask(`schema/${kind}`).then((schema) => schemas.set(kind, schema), () => schemas.delete(kind));
  }
  return schemas.get(kind);
}

function drawGutter() {
  const count = spec.value.split("\n").length;
  gutter.replaceChildren();
  for (let k = 1; k <= count; k++) {
    const number = document.createElement("span");
    number.textContent = `${k}\n`;
    if (wrongLines.has(k)) number.className = "wrong";
    gutter.append(number);
  }
  gutter.scrollTop = spec.scrollTop;
}

function goToLine(line) {
  const offset = spec.value.split("\n").slice(0, line - 1).reduce((sum, text) => sum + text.length + 1, 0);
  const end = spec.value.indexOf("\n", offset);
  spec.focus();
  spec.setSelectionRange(offset, end < 0 ? spec.value.length : end);
  spec.scrollTop = Math.max(0, (line - 5) * lineHeight());
}

const lineHeight = () => parseFloat(getComputedStyle(spec).lineHeight);

function showMistakes(checked) {
  const list = el("mistakes");
  list.replaceChildren();
  wrongLines = new Set(checked.mistakes.map((mistake) => mistake.line).filter(Boolean));
  drawGutter();
  for (const mistake of checked.mistakes) {
    const item = document.createElement("li"), button = document.createElement("button");
    const hint = mistake.suggestion ? ` (did you mean ${mistake.suggestion}?)` : "";
    button.type = "button";
    button.textContent = `${mistake.line ? `line ${mistake.line}: ` : ""}${mistake.key ? `${mistake.key}: ` : ""}${mistake.message}${hint}`;
    button.addEventListener("click", () => mistake.line && goToLine(mistake.line));
    item.append(button);
    list.append(item);
  }
  for (const [text, name] of [...checked.warnings.map((line) => [line, "warning"]), ...(checked.valid ? [[`no mistakes (${checked.kind})`, "good"]] : [])]) {
    const item = document.createElement("li");
    item.textContent = text;
    item.className = name;
    list.append(item);
  }
}

function check() {
  clearTimeout(checkTimer);
  checkTimer = setTimeout(async () => {
    const mine = ++checkCount;
    try {
      const checked = await ask("validate", { text: spec.value });
      if (mine === checkCount) showMistakes(checked);
    } catch (error) { if (mine === checkCount) tell(error.message); }
  }, 250);
}

function setSpec(text) {
  spec.value = text;
  spec.scrollTop = 0;
  hideCompletions();
  drawGutter();
  schemaOf(text);
  check();
}

function hideCompletions() { popup.hidden = true; choices = []; }

function offerCompletions() {
  const found = completionsAt(spec.value, spec.selectionStart, schemaOf(spec.value));
  [choices, chosen, word] = [found.entries, 0, found.word];
  if (!choices.length) return hideCompletions();
  popup.replaceChildren(...choices.map((entry, k) => {
    const item = document.createElement("li"), note = document.createElement("small");
    item.setAttribute("role", "option");
    item.setAttribute("aria-selected", String(k === 0));
    item.textContent = entry.label;
    note.textContent = entry.note;
    item.append(note);
    item.addEventListener("pointerdown", (event) => { event.preventDefault(); complete(k); });
    return item;
  }));
  const before = spec.value.slice(0, spec.selectionStart).split("\n");
  const column = before[before.length - 1].length - word.length;
  popup.hidden = false;
  const left = spec.offsetLeft + 6 + column * charWidth() - spec.scrollLeft;
  const top = 10 + before.length * lineHeight() - spec.scrollTop;
  popup.style.left = `${Math.max(0, Math.min(left, spec.offsetLeft + spec.clientWidth - popup.offsetWidth))}px`;
  const fits = top + popup.offsetHeight <= spec.clientHeight;
  popup.style.top = `${Math.max(0, fits ? top : top - popup.offsetHeight - lineHeight())}px`;
}

function charWidth() {
  const context = document.createElement("canvas").getContext("2d");
  context.font = getComputedStyle(spec).font;
  return context.measureText("0").width;
}

function mark(next) {
  popup.children[chosen].setAttribute("aria-selected", "false");
  chosen = (next + choices.length) % choices.length;
  popup.children[chosen].setAttribute("aria-selected", "true");
  popup.children[chosen].scrollIntoView({ block: "nearest" });
}

function complete(k) {
  const entry = choices[k], end = spec.selectionStart;
  spec.setRangeText(entry.insert, end - word.length, end, "end");
  hideCompletions();
  changed();
}

function changed() {
  drawGutter();
  check();
}

function showHint() { el("hint").textContent = hintAt(spec.value, spec.selectionStart, schemaOf(spec.value)); }

spec.addEventListener("input", (event) => {
  changed();
  if (event.inputType !== "insertFromPaste") offerCompletions();
  showHint();
});
spec.addEventListener("scroll", () => { gutter.scrollTop = spec.scrollTop; hideCompletions(); });
spec.addEventListener("blur", hideCompletions);
for (const name of ["click", "keyup"]) spec.addEventListener(name, showHint);
spec.addEventListener("keydown", (event) => {
  if (event.key === " " && event.ctrlKey) { event.preventDefault(); offerCompletions(); return; }
  if (choices.length) {
    if (event.key === "ArrowDown" || event.key === "ArrowUp") { event.preventDefault(); mark(chosen + (event.key === "ArrowDown" ? 1 : -1)); return; }
    if (event.key === "Tab" || event.key === "Enter") { event.preventDefault(); complete(chosen); return; }
    if (event.key === "Escape") { event.preventDefault(); hideCompletions(); return; }
  }
  if (event.key === "Enter" && !event.ctrlKey) { // keep the indentation
    const line = spec.value.slice(spec.value.lastIndexOf("\n", spec.selectionStart - 1) + 1, spec.selectionStart);
    const deeper = /:\s*$/.test(line) ? "  " : "";
    event.preventDefault();
    spec.setRangeText(`\n${/^\s*/.exec(line)[0]}${deeper}`, spec.selectionStart, spec.selectionEnd, "end");
    changed();
  } else if (event.key === "Enter") { event.preventDefault(); startPlan(); }
});

// --- open and save ---

function fillSources(all) {
  const source = el("source");
  source.replaceChildren(new Option("Open …", ""));
  for (const [kind, label] of [["files", "in this folder"], ["examples", "examples"]]) {
    const group = document.createElement("optgroup");
    group.label = label;
    for (const name of all[kind]) group.append(new Option(name, `${kind === "files" ? "file" : "example"}/${name}`));
    if (all[kind].length) source.append(group);
  }
}

async function openSpec(path) {
  try {
    setSpec((await ask(`spec/${path}`)).text);
    const [kind, name] = path.split("/");
    opened = kind === "file" ? name : "";
    el("file-name").value = kind === "file" ? name : `${name}.yaml`;
  } catch (error) { tell(error.message); }
}

el("source").addEventListener("change", (event) => { if (event.target.value) openSpec(event.target.value); });
el("save").addEventListener("click", async () => {
  const name = el("file-name").value.trim();
  const save = (replace) => ask("save", { name, text: spec.value, replace });
  try {
    try { await save(name === opened); } catch (error) {
      if (!error.message.endsWith("already exists") || !confirm(`${error.message}: replace it?`)) throw error;
      await save(true);
    }
    opened = name;
    tell(`saved ${name}`);
    fillSources(await ask("all"));
  } catch (error) { tell(error.message); }
});

// --- planning ---

async function startPlan() {
  if (running !== null) return;
  try {
    const answer = await ask("plan", { text: spec.value, quick: el("quick").checked });
    showMistakes(answer);
    if (answer.run) follow(answer.run);
    else tell("not planned: the spec has mistakes");
  } catch (error) { tell(error.message); }
}

function follow(run) {
  running = run.number;
  noteRun(run);
  el("plan").disabled = true;
  el("cancel").hidden = el("progress").hidden = false;
  el("lines").hidden = true;
  el("lines").textContent = "";
  el("progress").removeAttribute("value");
  const events = new EventSource(`events/${run.number}`);
  const began = performance.now();
  let facts = "";
  const clock = setInterval(() => tell(`plan ${run.number}: ${Math.round((performance.now() - began) / 1000)} s${facts && `, ${facts}`}`), 250);
  let first = true;
  events.onmessage = (event) => {
    const now = JSON.parse(event.data);
    if (first) { el("lines").textContent = ""; first = false; }
    if (now.progress) {
      facts = now.progress.replace(/\s+/g, " ").replace(/\d[\d:]* (s|min|h) elapsed,? ?/, "");
      const percent = / (\d+) % /.exec(`${now.progress} `);
      if (percent) el("progress").value = Number(percent[1]) / 100; else el("progress").removeAttribute("value");
    }
    if (now.lines.length) { el("lines").hidden = false; el("lines").textContent += now.lines.join("\n") + "\n"; el("lines").scrollTop = 1e9; }
    if (now.complete) { events.close(); clearInterval(clock); finish(now); }
  };
  events.onerror = () => { first = true; if (events.readyState === EventSource.CLOSED) { clearInterval(clock); tell("the server does not answer"); } };
}

function finish(run) {
  running = null;
  el("plan").disabled = false;
  el("cancel").hidden = el("progress").hidden = el("lines").hidden = true;
  tell(`plan ${run.number}: ${describeOutcome(run)} after ${run.seconds.toFixed(1)} s`);
  noteRun(run);
  show(run.number);
  // On a narrow screen the plan is below the editor
  if (matchMedia("(max-width: 900px)").matches) el("runs").scrollIntoView({ block: "start" });
}

const OUTCOMES = { fine: "fine", look: "look at this", do_not_use: "do not use" };
const describeOutcome = (run) => OUTCOMES[run.outcome] ?? run.outcome.replaceAll("_", " ");

el("plan").addEventListener("click", startPlan);
el("cancel").addEventListener("click", () => ask("cancel", {}).catch((error) => tell(error.message)));

// --- plans ---

function noteRun(run) {
  runs = [...runs.filter((one) => one.number !== run.number), run].sort((a, b) => a.number - b.number);
  el("runs").replaceChildren(...runs.filter((one) => one.complete).map((one) => {
    const button = document.createElement("button");
    button.type = "button";
    const cost = one.cost === null ? "" : ` · cost ${Number(one.cost).toPrecision(4)}`;
    button.textContent = `${one.number} · ${describeOutcome(one)}${cost}`;
    button.className = ["fine", "look"].includes(one.outcome) ? one.outcome : "bad";
    button.setAttribute("aria-pressed", String(one.number === shown));
    button.addEventListener("click", () => show(one.number));
    return button;
  }));
}

function replayOf(run) {
  const figure = document.createElement("figure"), caption = document.createElement("figcaption"), frame = document.createElement("iframe");
  caption.textContent = `plan ${run.number}`;
  frame.src = `replay/${run.number}`;
  frame.title = `Replay of plan ${run.number}`;
  frame.setAttribute("sandbox", "allow-scripts");
  figure.append(frame, caption);
  return figure;
}

async function show(number, other = null) {
  const [first, second] = other === null ? [number, null] : [Math.min(number, other), Math.max(number, other)];
  const run = runs.find((one) => one.number === number);
  shown = number;
  noteRun(run);
  el("empty").hidden = true;
  el("shown").hidden = false;
  el("shown-title").textContent = other === null ? `Plan ${number}` : `Plans ${first} and ${second}`;
  const others = runs.filter((one) => one.number !== number && one.complete);
  el("other").replaceChildren(new Option("nothing", ""), ...others.map((one) => new Option(`plan ${one.number}`, one.number)));
  el("other").value = other === null ? "" : String(other);
  el("other").parentElement.hidden = !others.length;
  const pair = runs.filter((one) => one.number === first || one.number === second);
  el("replays").replaceChildren(...pair.filter((one) => one.replayable).map(replayOf));
  try {
    el("outcome").innerHTML = await ask(other === null ? `outcome/${number}` : `comparison/${first}/${second}`);
  } catch (error) { el("outcome").textContent = error.message; }
}

el("other").addEventListener("change", (event) => show(shown, event.target.value ? Number(event.target.value) : null));

// --- begin ---

(async () => {
  const all = await ask("all");
  fillSources(all);
  for (const run of all.runs) noteRun(run);
  const active = runs.find((run) => !run.complete);
  if (active) follow(active);
  const last = runs.filter((run) => run.complete).pop();
  if (last) show(last.number);
  await openSpec(`example/${values.first}`);
})();
