"use strict";

// Completion of YAML by a JSON Schema: where the cursor is, which keys and values may stand there.

const MEMBER = "[]"; // of a path: an entry of a list

// The schemas that may describe one place: references followed, alternatives listed
function alternatives(node, root, depth = 0) {
  if (!node || typeof node !== "object" || depth > 12) return [];
  if (node.$ref) {
    const target = node.$ref.startsWith("#/") ? node.$ref.slice(2).split("/").reduce((n, k) => n && n[k], root) : null;
    return alternatives(target, root, depth + 1).map((found) => ({ ...found, description: node.description ?? found.description }));
  }
  const branches = [...(node.anyOf ?? []), ...(node.oneOf ?? []), ...(node.allOf ?? [])];
  if (!branches.length) return [node];
  return branches.flatMap((branch) => alternatives(branch, root, depth + 1));
}

function describeAt(path, root) {
  let nodes = alternatives(root, root), property = null;
  for (const step of path) {
    const next = nodes.flatMap((node) => {
      if (step === MEMBER) return [node.items, ...(node.prefixItems ?? [])].filter(Boolean);
      const found = node.properties?.[step] ?? (typeof node.additionalProperties === "object" ? node.additionalProperties : null);
      return found ? [found] : [];
    });
    property = next[0] ?? null;
    nodes = next.flatMap((node) => alternatives(node, root));
  }
  return { nodes, property };
}

const KEY = /^(\s*)((?:- +)*)(?:"([^"]*)"|([\w.-]+))\s*:(?=\s|$)/;
const withoutComment = (line) => line.replace(/(^|\s)#.*$/, "$1");

// Frames of the mappings and lists that a place in block style lies in: { step, column, names }
function leaveTo(frames, column, isDash) {
  // The dashes of a list may stand as far left as its key
  const ends = (top) => top.column > column || (top.column === column && (!isDash || top.step === MEMBER));
  while (frames.length > 1 && ends(frames[frames.length - 1])) frames.pop();
}

function enter(frames, step, column) {
  frames[frames.length - 1].names.add(step);
  frames.push({ step, column, names: new Set() });
}

function readBlock(frames, line) {
  const head = /^(\s*)((?:- +)*)/.exec(line);
  let column = head[1].length;
  for (const dash of head[2].match(/- +/g) ?? []) {
    leaveTo(frames, column, true);
    enter(frames, MEMBER, column);
    column += dash.length;
  }
  const found = KEY.exec(line);
  if (found) {
    leaveTo(frames, column, false);
    enter(frames, found[3] ?? found[4], column);
  }
  return column;
}

function framesAt(lines, row, head) {
  const frames = [{ step: null, column: -1, names: new Set() }];
  for (const line of lines.slice(0, row).map(withoutComment)) if (line.trim()) readBlock(frames, line);
  const column = readBlock(frames, head);
  leaveTo(frames, column, false);
  const names = new Set(frames[frames.length - 1].names);
  for (const line of lines.slice(row + 1).map(withoutComment)) { // keys below that stand beside it
    if (!line.trim()) continue;
    const found = KEY.exec(line);
    if (/^\s*/.exec(line)[0].length < column || (found?.[2] && found[1].length <= column)) break;
    if (found && !found[2] && found[1].length === column) names.add(found[3] ?? found[4]);
  }
  return { path: frames.slice(1).map((frame) => frame.step), names };
}

// Keys of braces that are open at the end of a text, and of lists as MEMBER
function flowPath(text) {
  const open = [];
  let key = null, start = 0;
  for (let k = 0; k < text.length; k++) {
    const c = text[k];
    if (c === "{" || c === "[") {
      const before = /([\w.-]+)\s*:\s*$/.exec(text.slice(start, k));
      if (before) key = before[1];
      open.push({ kind: c, key, keys: new Set() });
      key = null; start = k + 1;
    } else if ((c === "}" || c === "]") && open.length) { open.pop(); start = k + 1; } else if (c === ",") start = k + 1;
    else if (c === ":" && open.length) { const name = /([\w.-]+)\s*$/.exec(text.slice(start, k)); if (name) open[open.length - 1].keys.add(name[1]); }
  }
  return { open, rest: text.slice(start) };
}

// Where a cursor is: path of the mapping or value, and the word before the cursor
function placeOf(text, offset) {
  const lines = text.split("\n"), before = text.slice(0, offset).split("\n");
  const row = before.length - 1, prefix = before[row];
  if (/(^|\s)#/.test(prefix)) return null;
  const head = /^(\s*)((?:- +)*)/.exec(prefix);
  const indent = head[1].length + head[2].length;
  const place = framesAt(lines, row, head[0]), path = place.path;
  let rest = prefix.slice(indent), names = place.names;
  const { open, rest: tail } = flowPath(rest);
  if (open.length) {
    for (const brace of open) {
      if (brace.key) path.push(brace.key);
      if (brace.kind === "[") path.push(MEMBER);
    }
    rest = tail.trimStart();
    names = open[open.length - 1].keys;
    if (open[open.length - 1].kind === "[") return { path, word: rest, isKey: false, names };
  }
  const value = /^(?:"([^"]*)"|([\w.-]+))\s*:\s+(.*)$/.exec(rest);
  if (value) return { path: [...path, value[1] ?? value[2]], word: value[3], isKey: false, names };
  if (/^[\w.-]*$/.test(rest)) return { path, word: rest, isKey: true, names: new Set([...names].filter((name) => name !== rest)) };
  return null;
}

function completionsAt(text, offset, root) {
  const place = placeOf(text, offset);
  if (!place || !root) return { word: "", entries: [] };
  const { nodes } = describeAt(place.path, root);
  const entries = new Map();
  if (place.isKey)
    for (const node of nodes) for (const [name, property] of Object.entries(node.properties ?? {})) {
      if (place.names.has(name) || entries.has(name)) continue;
      const isNested = alternatives(property, root).some((found) => found.properties) && !("default" in property && property.default !== null && typeof property.default !== "object");
      entries.set(name, { label: name, insert: `${name}:${isNested ? "" : " "}`, note: noteOf(property, root) });
    }
  else
    for (const node of nodes) {
      const values = node.enum ?? ("const" in node ? [node.const] : node.type === "boolean" ? [true, false] : node.type === "null" ? ["null"] : []);
      for (const entry of values) entries.set(String(entry), { label: String(entry), insert: String(entry), note: "" });
    }
  const word = place.word.toLowerCase();
  const fitting = [...entries.values()].filter((entry) => entry.label.toLowerCase().includes(word) && entry.label !== place.word);
  fitting.sort((a, b) => Number(b.label.toLowerCase().startsWith(word)) - Number(a.label.toLowerCase().startsWith(word)));
  return { word: place.word, entries: fitting.slice(0, 40) };
}

function noteOf(property, root) {
  const description = property.description ?? alternatives(property, root)[0]?.description ?? "";
  const simple = property.default !== null && ["number", "string", "boolean"].includes(typeof property.default);
  return description.split("\n")[0] + (simple ? ` (default ${property.default})` : "");
}

// One line about the key under the cursor
function hintAt(text, offset, root) {
  if (!root) return "";
  const end = text.indexOf("\n", offset), line = text.slice(text.lastIndexOf("\n", offset - 1) + 1, end < 0 ? text.length : end);
  const found = KEY.exec(line);
  const place = placeOf(text, offset);
  if (!place) return "";
  const path = place.isKey && found ? [...place.path, found[3] ?? found[4]] : place.path;
  const { property } = describeAt(path, root);
  return property ? `${path.filter((step) => step !== MEMBER).join(".")}: ${noteOf(property, root)}` : "";
}
