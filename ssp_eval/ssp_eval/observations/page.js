// The observer's form. What is saved is a draft without a seal; `ssp audit observe --seal` checks,
// binds and seals it, so that nothing here has to hash as Python does.
const FRAMES = DATA.frames;
const CARDS = DATA.cards;
const KEY = "ssp.observation:" + DATA.draft.bag_sha256;
const copy = (value) => JSON.parse(JSON.stringify(value));

function fresh() {
  // cannot: paths of answers that the observer couldn't give, which isn't the same as open ones.
  return { doc: copy(DATA.draft), cannot: {} };
}
let state = fresh();
let active = 0;
let now = 0;
let spanFrom = null;
let playing = null;
let zoom = { k: 1, x: 0, y: 0 };

function get(path) {
  return path.split(".").reduce((at, key) => (at === undefined || at === null ? undefined : at[key]), state.doc);
}
function put(path, value) {
  const keys = path.split(".");
  const last = keys.pop();
  keys.reduce((at, key) => at[key], state.doc)[last] = value;
}
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
const seconds = (t) => t.toFixed(3) + " s";

// -- what is open --------------------------------------------------------------------------------
function isIdle(ask) {
  return ask.idle_if !== null && get(ask.idle_if[0]) === ask.idle_if[1];
}
function isAnswered(ask) {
  const value = get(ask.path);
  return value !== null && value !== undefined;
}
function problems(card) {
  const found = [];
  for (const ask of card.asks) {
    if (!ask.optional && !isIdle(ask) && !isAnswered(ask) && !state.cannot[ask.path]) found.push("open");
  }
  if (card.path && card.asks.some(isAnswered) && get(card.path + ".frames").length === 0) found.push("evidence");
  if (card.key && isAnswered(card.asks[0])) {
    const before = { c: "phases.trigger.t_s", r: "phases.conflict.t_s" }[card.key];
    const t = before && get(before);
    if (t !== null && t !== undefined && get(card.asks[0].path) <= t) found.push("order");
  }
  return found;
}
const firstOpen = () => {
  if (!$("who").value.trim()) return -1;
  const found = CARDS.findIndex((card, i) => i > active && problems(card).length);
  return found >= 0 ? found : CARDS.findIndex((card) => problems(card).length);
};

// -- the recording -------------------------------------------------------------------------------
function show(k) {
  now = Math.max(0, Math.min(FRAMES.length - 1, k));
  const frame = FRAMES[now];
  $("picture").src = frame.src;
  $("slider").value = now;
  $("time").innerHTML = `<b>${seconds(frame.t)}</b> · frame ${frame.n}`;
  drawStrip();
  drawPick();
}
function nearest(n) {
  // The last shown frame at or before an index of the recording.
  let found = 0;
  FRAMES.forEach((frame, k) => { if (frame.n <= n) found = k; });
  return found;
}
function atTime(t) {
  let found = 0;
  FRAMES.forEach((frame, k) => { if (frame.t <= t + 1e-6) found = k; });
  return found;
}
function play() {
  if (playing !== null) {
    clearTimeout(playing);
    playing = null;
  } else {
    if (now === FRAMES.length - 1) show(0);
    tick();
  }
  $("play").textContent = playing === null ? "▶" : "❚❚";
}
function tick() {
  if (now + 1 >= FRAMES.length) {
    playing = null;
    $("play").textContent = "▶";
    return;
  }
  playing = setTimeout(() => { show(now + 1); tick(); }, 1000 * Math.max(0.02, FRAMES[now + 1].t - FRAMES[now].t));
}
function stop() {
  if (playing !== null) play();
}
function step(by) {
  stop();
  show(now + by);
}
const covers = (item, n) => (Array.isArray(item) ? item[0] <= n && n <= item[1] : item === n);

function drawStrip() {
  const strip = $("strip");
  strip.replaceChildren();
  const first = Math.max(0, Math.min(now - 3, FRAMES.length - 7));
  const evidence = evidenceOf(CARDS[active]);
  for (let k = first; k < Math.min(first + 7, FRAMES.length); k++) {
    const image = new Image();
    image.src = FRAMES[k].src;
    image.alt = "";
    const button = element("button", { type: "button", title: "Go to frame " + FRAMES[k].n }, image, FRAMES[k].t.toFixed(2));
    if (evidence.some((item) => covers(item, FRAMES[k].n))) button.classList.add("ev");
    if (k === now) button.classList.add("now");
    button.onclick = () => step(k - now);
    strip.append(button);
  }
}
function drawMarks() {
  const marks = $("marks");
  marks.replaceChildren();
  const place = (k) => (FRAMES.length > 1 ? (100 * k) / (FRAMES.length - 1) : 0);
  for (const item of evidenceOf(CARDS[active])) {
    const [a, b] = Array.isArray(item) ? item : [item, item];
    const left = place(nearest(a));
    marks.append(element("i", { style: `left:${left}%;width:${Math.max(0, place(nearest(b)) - left)}%`, title: "evidence" }));
  }
  for (const phase of ["trigger", "conflict", "resolution"]) {
    const t = get(`phases.${phase}.t_s`);
    if (t !== null) marks.append(element("i", { class: phase, style: `left:${place(atTime(t))}%`, title: `${phase} begins at ${seconds(t)}` }));
  }
}
function setZoom(by, x, y) {
  const box = $("stage").getBoundingClientRect();
  const px = x === undefined ? box.width / 2 : x - box.left;
  const py = y === undefined ? box.height / 2 : y - box.top;
  const k = by === 0 ? 1 : Math.max(1, Math.min(12, zoom.k * by));
  zoom.x = px - ((px - zoom.x) * k) / zoom.k;
  zoom.y = py - ((py - zoom.y) * k) / zoom.k;
  zoom.k = k;
  pan(0, 0);
}
function pan(dx, dy) {
  const box = $("stage").getBoundingClientRect();
  zoom.x = Math.min(0, Math.max(box.width * (1 - zoom.k), zoom.x + dx));
  zoom.y = Math.min(0, Math.max(box.height * (1 - zoom.k), zoom.y + dy));
  $("picture").style.transform = zoom.k === 1 ? "" : `translate(${zoom.x}px, ${zoom.y}px) scale(${zoom.k})`;
}

// -- evidence ------------------------------------------------------------------------------------
const evidenceOf = (card) => (card && card.path ? get(card.path + ".frames") : []);

function mark() {
  const card = CARDS[active];
  if (!card.path) return tell("This question needs no frames.");
  const n = FRAMES[now].n;
  const frames = evidenceOf(card);
  const at = frames.findIndex((item) => same(item, n));
  if (at >= 0) frames.splice(at, 1);
  else if (!frames.some((item) => covers(item, n))) frames.push(n);
  touch();
}
function span() {
  const card = CARDS[active];
  if (!card.path) return tell("This question needs no frames.");
  const n = FRAMES[now].n;
  if (spanFrom === null) spanFrom = n;
  else {
    addSpan(card, Math.min(spanFrom, n), Math.max(spanFrom, n));
    spanFrom = null;
  }
  touch();
}
function addSpan(card, a, b) {
  // What lies inside the span needs no mark of its own.
  const kept = evidenceOf(card).filter((item) => !(covers([a, b], Array.isArray(item) ? item[0] : item) && covers([a, b], Array.isArray(item) ? item[1] : item)));
  put(card.path + ".frames", [...kept, a === b ? a : [a, b]]);
}
function all() {
  const card = CARDS[active];
  if (!card.path) return tell("This question needs no frames.");
  addSpan(card, FRAMES[0].n, FRAMES[FRAMES.length - 1].n);
  touch();
}
function drawPick() {
  const card = CARDS[active];
  $("active").replaceChildren(
    card.path ? "Evidence for: " : "No frames needed: ", element("b", {}, card.title));
  $("span").innerHTML = spanFrom === null ? "Span from here <kbd>S</kbd>" : `Span ${spanFrom} to here <kbd>S</kbd>`;
  $("stage").classList.toggle("marked", evidenceOf(card).some((item) => covers(item, FRAMES[now].n)));
}
function setPhase(key) {
  const index = CARDS.findIndex((card) => card.key === key);
  activate(index, true);
  const card = CARDS[index];
  put(card.asks[0].path, Math.round(FRAMES[now].t * 1000) / 1000);
  delete state.cannot[card.asks[0].path];
  put(card.path + ".frames", [FRAMES[now].n]);
  touch();
}

// -- the form ------------------------------------------------------------------------------------
function build() {
  const root = $("cards");
  root.replaceChildren();
  let section = "";
  CARDS.forEach((card, i) => {
    if (card.section !== section) root.append(element("h2", {}, (section = card.section)));
    const box = element("section", { class: "card", id: "card-" + i, "data-path": card.path });
    box.addEventListener("focusin", () => activate(i));
    box.addEventListener("click", () => activate(i));
    root.append(box);
  });
  CARDS.forEach((_, i) => fill(i));
}
function fill(i) {
  const card = CARDS[i];
  const box = $("card-" + i);
  const held = document.activeElement && box.contains(document.activeElement) ? document.activeElement.dataset.at : null;
  box.replaceChildren(element("h3", {}, card.title));
  if (card.help) box.append(element("p", { class: "help" }, card.help));
  for (const ask of card.asks) box.append(drawAsk(card, ask));
  if (card.path) box.append(drawEvidence(card), drawNote(card));
  const open = problems(card);
  box.classList.toggle("todo", open.includes("open"));
  box.classList.toggle("done", open.length === 0);
  box.classList.toggle("active", i === active);
  if (held) box.querySelector(`[data-at="${CSS.escape(held)}"]`)?.focus({ preventScroll: true });
}
function answer(ask, value) {
  put(ask.path, value);
  delete state.cannot[ask.path];
  const card = CARDS.find((one) => one.asks.includes(ask));
  // What is said of the whole recording rests on all of its frames.
  if (card.whole_for.some((one) => same(one, value)) && get(card.path + ".frames").length === 0) {
    addSpan(card, FRAMES[0].n, FRAMES[FRAMES.length - 1].n);
  }
  touch();
}
function cannot(ask) {
  const card = CARDS.find((one) => one.asks.includes(ask));
  put(ask.path, null);
  if (state.cannot[ask.path]) delete state.cannot[ask.path];
  else state.cannot[ask.path] = true;
  // A time's frame is its evidence.
  if (ask.kind === "time" && card.path) put(card.path + ".frames", []);
  touch();
}
function chip(ask, at, text, pressed, act, extra) {
  const button = element("button", { type: "button", "data-at": ask.path + "=" + at, "aria-pressed": String(pressed), class: extra || undefined }, text);
  button.onclick = act;
  return button;
}
function drawAsk(card, ask) {
  const box = element("div", { class: "ask", role: "group", "aria-label": ask.label || card.title, "data-ask": ask.path });
  if (ask.label) box.append(element("span", {}, ask.label));
  const value = get(ask.path);
  const chips = element("div", { class: "chips" });
  box.append(chips);
  if (isIdle(ask)) {
    box.classList.add("idle");
    chips.append("needn't be said: there is only one");
    return box;
  }
  if (ask.kind === "time") {
    const setting = card.key ? () => setPhase(card.key) : () => answer(ask, Math.round(FRAMES[now].t * 1000) / 1000);
    const text = element("span", {}, "Begins at this frame ");
    if (!card.key) text.textContent = "At this frame";
    else text.append(element("kbd", {}, card.key.toUpperCase()));
    chips.append(chip(ask, "now", text, false, setting));
    if (value !== null) {
      const go = chip(ask, "go", `${seconds(value)} – go there`, true, () => { stop(); show(atTime(value)); });
      const clear = chip(ask, "clear", "✕", false, () => { put(ask.path, null); if (card.path) put(card.path + ".frames", []); touch(); });
      clear.title = "Take the time back";
      chips.append(go, clear);
    }
  } else if (ask.kind === "share") {
    chips.append(
      chip(ask, "throughout", "throughout", value === "throughout", () => answer(ask, value === "throughout" ? null : "throughout")),
      chip(ask, "never", "never", value === "never", () => answer(ask, value === "never" ? null : "never")));
    const input = element("input", { type: "number", min: 0, max: 100, step: 5, placeholder: "share, %", "aria-label": "share in percent", "data-at": ask.path + "=share" });
    if (typeof value === "number") input.value = Math.round(value * 1000) / 10;
    input.onchange = () => answer(ask, input.value === "" ? null : Math.max(0, Math.min(100, Number(input.value))) / 100);
    chips.append(input);
  } else if (ask.kind === "lines") {
    chips.append(chip(ask, "nothing", "nothing", value !== null && value.length === 0, () => answer(ask, value !== null && value.length === 0 ? null : [])));
    const input = element("textarea", { rows: 2, "data-at": ask.path + "=lines", "aria-label": ask.label });
    input.value = (value || []).join("\n");
    input.onchange = () => {
      const lines = input.value.split("\n").map((line) => line.trim()).filter(Boolean);
      answer(ask, lines.length ? lines : null);
    };
    box.append(input);
  } else {
    ask.words.forEach(([word, text], at) => {
      chips.append(chip(ask, at, text, same(value, word), () => answer(ask, same(value, word) ? null : word)));
    });
  }
  if (!ask.optional) chips.append(chip(ask, "unknown", "can't tell", Boolean(state.cannot[ask.path]), () => cannot(ask), "unknown"));
  return box;
}
function drawEvidence(card) {
  const frames = get(card.path + ".frames");
  const box = element("div", { class: "evidence" }, "Evidence: ");
  const open = problems(card);
  frames.forEach((item, at) => {
    const text = Array.isArray(item) ? `frames ${item[0]}–${item[1]}` : `frame ${item}`;
    const go = element("button", { type: "button", class: "frame", title: "Go there" }, text);
    go.onclick = () => { stop(); show(nearest(Array.isArray(item) ? item[0] : item)); };
    const away = element("button", { type: "button", title: "Take it back", "aria-label": "Take back " + text }, "✕");
    away.onclick = () => { frames.splice(at, 1); touch(); };
    box.append(go, away);
  });
  if (open.includes("evidence")) box.append(element("span", { class: "lacks" }, "which frames show it? Click the picture, or press E"));
  else if (frames.length === 0) box.append("no frame yet");
  if (open.includes("order")) box.append(element("span", { class: "lacks" }, "must begin after the phase before it"));
  return box;
}
function drawNote(card) {
  const note = get(card.path + ".note");
  if (note === null && !card.noting) {
    const button = element("button", { type: "button", class: "plain note" }, "Add a note");
    button.onclick = () => { card.noting = true; fill(CARDS.indexOf(card)); $("card-" + CARDS.indexOf(card)).querySelector("input.note").focus(); };
    return button;
  }
  const input = element("input", { class: "note", maxlength: 500, placeholder: "Note", "aria-label": "Note" });
  input.value = note || "";
  input.onchange = () => { put(card.path + ".note", input.value.trim() || null); touch(); };
  return input;
}
function activate(i, scroll) {
  if (i !== active) {
    const before = active;
    active = i;
    spanFrom = null;
    $("card-" + before).classList.remove("active");
    $("card-" + i).classList.add("active");
    drawMarks();
    drawStrip();
    drawPick();
  }
  if (scroll) $("card-" + i).scrollIntoView({ block: "nearest" });
}
function tell(text) {
  $("told").textContent = text;
}
function touch() {
  setChanged(true);
  redraw();
  keep();
}
function redraw() {
  CARDS.forEach((_, i) => fill(i));
  drawMarks();
  drawStrip();
  drawPick();
  drawMissing();
}
function drawMissing() {
  const open = CARDS.filter((card) => problems(card).length).length + (!$("who").value.trim() ? 1 : 0);
  $("missing").textContent = open ? `${open} open` : "all answered";
  $("missing").classList.toggle("done", open === 0);
}
function next() {
  const found = firstOpen();
  if (found === -1 && !$("who").value.trim()) return $("who").focus();
  if (found >= 0) {
    activate(found);
    $("card-" + found).scrollIntoView({ block: "center" });
  }
}

// -- keeping and saving --------------------------------------------------------------------------
function keep() {
  const person = { who: $("who").value, role: $("role").value, remark: $("remark").value };
  memory.keeps(KEY, { ...state, person }); // without storage the draft lives as long as the page
}
function offer() {
  // Another person may sit here now, and observers look for themselves: nothing comes back unasked.
  const found = memory.read(KEY);
  if (!found || !same(shape(found.doc), shape(DATA.draft))) return;
  const panel = $("saved");
  const again = element("button", { type: "button", id: "go-on" }, "Go on with them");
  again.onclick = () => {
    state = { doc: found.doc, cannot: found.cannot };
    for (const key of ["who", "role", "remark"]) $(key).value = found.person[key] || "";
    panel.hidden = true;
    touch();
  };
  const drop = element("button", { type: "button", id: "drop" }, "Drop them");
  drop.onclick = () => {
    memory.drop(KEY);
    panel.hidden = true;
  };
  panel.classList.add("warn");
  panel.replaceChildren(
    element("p", {}, "Unsaved answers of ", element("b", {}, found.person.who || "somebody"), " are kept on this computer. Are they yours?"),
    element("p", { class: "row" }, again, drop));
  panel.hidden = false;
}
function shape(value) {
  // Keys of nested objects, without lists and answers.
  if (value === null || typeof value !== "object" || Array.isArray(value)) return 0;
  return Object.fromEntries(Object.keys(value).sort().map((key) => [key, shape(value[key])]));
}
function load(text) {
  let found;
  try {
    found = JSON.parse(text);
  } catch (error) {
    return tell("That file is no JSON: " + error.message);
  }
  if (found?.schema !== DATA.draft.schema) return tell("That file is no observation.");
  if (found.bag_sha256 !== DATA.draft.bag_sha256) return tell("That observation is of another recording.");
  const doc = { ...found, seal: null, who: null, role: null, when: null, remark: null };
  if (!same(shape(doc), shape(DATA.draft))) return tell("That observation names other participants.");
  for (const key of ["who", "role", "remark"]) $(key).value = found[key] || "";
  state = { doc, cannot: {} };
  tell("The draft is loaded. What was null in it is open again.");
  touch();
}
const onLeave = (event) => event.preventDefault();
function setChanged(value) {
  // Leaving the page asks only where something would be lost.
  if (value) window.addEventListener("beforeunload", onLeave);
  else window.removeEventListener("beforeunload", onLeave);
}
function result() {
  const doc = copy(state.doc);
  doc.who = $("who").value.trim();
  doc.role = $("role").value.trim() || null;
  doc.remark = $("remark").value.trim() || null;
  doc.when = new Date().toISOString().replace(/\.\d+Z$/, "Z");
  return doc;
}
function save(allTheSame) {
  const panel = $("saved");
  panel.hidden = false;
  panel.replaceChildren();
  const say = (...children) => panel.append(element("p", {}, ...children));
  panel.classList.add("warn");
  if (!$("who").value.trim()) {
    say("An observation has a name: whose is it?");
    return $("who").focus();
  }
  const wrong = CARDS.filter((card) => problems(card).some((one) => one !== "open"));
  const open = CARDS.filter((card) => problems(card).includes("open"));
  const list = (cards) => {
    const made = element("p", {});
    cards.forEach((card) => {
      const button = element("button", { type: "button", class: "plain" }, card.title);
      button.onclick = () => { activate(CARDS.indexOf(card)); $("card-" + CARDS.indexOf(card)).scrollIntoView({ block: "center" }); };
      made.append(button);
    });
    panel.append(made);
    window.scrollTo({ top: 0 });
  };
  if (wrong.length) {
    say("Not saved. These lack frames that show them, or are out of order:");
    return list(wrong);
  }
  if (open.length && !allTheSame) {
    say(`${open.length} of ${CARDS.length} questions are open. Answer them, or say that you can't tell:`);
    list(open);
    const button = element("button", { type: "button", id: "save-open" }, "Save all the same, open ones as \u201ccan't tell\u201d");
    button.onclick = () => save(true);
    panel.append(button);
    return;
  }
  const doc = result();
  const plain = (text) => text.replace(/[^A-Za-z0-9_.-]+/g, "_");
  const name = plain(`draft_${doc.recording}_${doc.who}`) + ".json";
  download(name, doc);
  setChanged(false);
  memory.drop(KEY);
  panel.classList.remove("warn");
  say(element("b", {}, name), " lies in your downloads. It counts once it is checked, bound to the recording and sealed:");
  panel.append(element("code", {}, `ssp audit observe ${quoted(DATA.bag)} --seal ${name}`));
  window.scrollTo({ top: 0 });
}
const quoted = (text) => (/^[A-Za-z0-9_./-]+$/.test(text) ? text : "'" + text.replaceAll("'", "'\\''") + "'");

// -- hands ---------------------------------------------------------------------------------------
document.addEventListener("keydown", (event) => {
  const typing = event.target.matches("input:not([type=range]), textarea");
  if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
  const by = event.shiftKey ? 10 : 1;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const acts = {
    ArrowLeft: () => step(-by), ArrowRight: () => step(by),
    Home: () => step(-FRAMES.length), End: () => step(FRAMES.length),
    e: mark, s: span, a: all, k: play, n: next,
    t: () => setPhase("t"), c: () => setPhase("c"), r: () => setPhase("r"),
    "+": () => setZoom(1.25), "-": () => setZoom(0.8), 0: () => setZoom(0),
  };
  if (key === " " && !event.target.matches("button")) acts[" "] = play;
  if (acts[key]) {
    event.preventDefault();
    acts[key]();
  }
});
// After a click the keys belong to the recording again.
document.addEventListener("click", (event) => {
  const button = event.target.closest("button");
  if (button && event.detail > 0) button.blur();
});
document.querySelectorAll("[data-step]").forEach((b) => { b.onclick = () => step(Number(b.dataset.step)); });
document.querySelectorAll("[data-zoom]").forEach((b) => { b.onclick = () => setZoom(Number(b.dataset.zoom)); });
$("play").onclick = play;
$("mark").onclick = mark;
$("span").onclick = span;
$("all").onclick = all;
$("missing").onclick = next;
$("save").onclick = () => save(false);
$("slider").max = FRAMES.length - 1;
$("slider").oninput = () => { stop(); show(Number($("slider").value)); };
$("form").onsubmit = (event) => event.preventDefault();
for (const key of ["who", "role", "remark"]) $(key).oninput = () => { setChanged(true); keep(); drawMissing(); };
$("load").onchange = () => {
  const file = $("load").files[0];
  if (file) file.text().then(load);
};
$("anew").onclick = () => {
  if (!confirm("Drop all answers on this page?")) return;
  state = fresh();
  tell("");
  touch();
};
const stage = $("stage");
let drag = null;
stage.addEventListener("pointerdown", (event) => {
  drag = { x: event.clientX, y: event.clientY, moved: false };
  stage.setPointerCapture(event.pointerId);
});
stage.addEventListener("pointermove", (event) => {
  if (drag === null) return;
  const [dx, dy] = [event.clientX - drag.x, event.clientY - drag.y];
  if (drag.moved || Math.hypot(dx, dy) > 4) {
    pan(dx, dy);
    drag = { x: event.clientX, y: event.clientY, moved: true };
  }
});
let clicked = null;
stage.addEventListener("pointerup", () => {
  const moved = drag === null || drag.moved;
  drag = null;
  if (moved) return;
  if (clicked !== null) {
    // A second click in time is a double click: the whole frame, and no mark.
    clearTimeout(clicked);
    clicked = null;
    setZoom(0);
    return;
  }
  clicked = setTimeout(() => { clicked = null; mark(); }, 220);
});
stage.addEventListener("wheel", (event) => {
  event.preventDefault();
  setZoom(event.deltaY < 0 ? 1.2 : 1 / 1.2, event.clientX, event.clientY);
}, { passive: false });
window.addEventListener("resize", () => setZoom(0));

build();
show(0);
redraw();
offer();
