"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const at = (id) => document.getElementById(id);
const store = `ssp-review ${data.subset} ${data.reviewer}`;
const ids = data.texts.map((one) => one.id);
let answers = {};
let index = 0;
let current = 0;

// What was answered survives a closed window; a browser that keeps nothing still can export.
try {
  const kept = JSON.parse(localStorage.getItem(store) || "{}");
  take(kept.answers || {});
  index = Math.min(Math.max(kept.index || 0, 0), ids.length - 1);
} catch {
  say("This browser keeps no answers: save them before you close the window.", true);
}

function take(given) {
  for (const id of ids) {
    const one = given[id];
    if (typeof one !== "object" || one === null) continue;
    answers[id] = {};
    for (const slot of data.slots) {
      const allowed = [...slot.values, data.none, data.unsure];
      const parts = String(one[slot.name] ?? "").split("+").filter((part) => allowed.includes(part));
      if (parts.length) answers[id][slot.name] = parts.join("+");
    }
    if (typeof one.comment === "string" && one.comment) answers[id].comment = one.comment;
  }
}

function keep() {
  try {
    localStorage.setItem(store, JSON.stringify({ answers, index }));
  } catch {
    say("This browser keeps no answers: save them before you close the window.", true);
  }
}

function say(text, wrong = false) {
  at("say").textContent = text;
  at("say").className = wrong ? "wrong" : "";
  clearTimeout(say.timer);
  say.timer = setTimeout(() => { at("say").textContent = ""; }, wrong ? 8000 : 3000);
}

const answer = (id) => (answers[id] ||= {});
const chosen = (slot) => (answer(ids[index])[slot.name] || "").split("+").filter(Boolean);
const whole = (id) => data.slots.every((slot) => (answers[id] || {})[slot.name]);

function choose(slot, value) {
  let now = chosen(slot);
  if (now.includes(value)) {
    now = now.filter((one) => one !== value);
  } else if (slot.several && !data.alone.includes(value)) {
    now = [...now.filter((one) => !data.alone.includes(one)), value];
    now = slot.values.filter((one) => now.includes(one));
  } else {
    now = [value];
  }
  if (now.length) answer(ids[index])[slot.name] = now.join("+");
  else delete answer(ids[index])[slot.name];
  keep();
  mark();
}

// Built once; a text changes only what is checked.
const fields = data.slots.map((slot, number) => {
  const field = document.createElement("fieldset");
  const legend = document.createElement("legend");
  legend.textContent = slot.title;
  const name = document.createElement("small");
  name.textContent = slot.name + (slot.several ? ", any number" : "");
  legend.append(name);
  const choices = document.createElement("div");
  choices.className = "choices";
  const inputs = new Map();
  [...slot.values, data.none, data.unsure].forEach((value, place) => {
    const label = document.createElement("label");
    if (data.alone.includes(value)) label.className = "alone";
    const input = document.createElement("input");
    input.type = "checkbox";
    input.setAttribute("aria-label", `${slot.name}: ${value}`);
    input.addEventListener("change", () => { go(number); choose(slot, value); });
    const key = document.createElement("kbd");
    key.textContent = value === data.none ? "0" : value === data.unsure ? "?" : String(place + 1);
    label.append(input, key, value);
    choices.append(label);
    inputs.set(value, input);
  });
  field.append(legend, choices);
  field.addEventListener("pointerdown", () => go(number));
  field.addEventListener("focusin", () => go(number));
  at("slots").append(field);
  return { field, inputs };
});

function mark() {
  data.slots.forEach((slot, number) => {
    const now = chosen(slot);
    fields[number].inputs.forEach((input, value) => { input.checked = now.includes(value); });
    fields[number].field.classList.toggle("answered", now.length > 0);
    fields[number].field.classList.toggle("current", number === current);
  });
  at("rule").textContent = data.slots[current].rule;
  const done = ids.filter(whole).length;
  at("done").textContent = `${done} of ${ids.length} answered`;
  at("fill").style.width = `${(100 * done) / ids.length}%`;
  at("fill").parentElement.setAttribute("aria-valuenow", done);
}

function go(number) {
  current = Math.min(Math.max(number, 0), data.slots.length - 1);
  mark();
}

function show(number) {
  index = Math.min(Math.max(number, 0), ids.length - 1);
  at("text").textContent = data.texts[index].text;
  at("text").scrollTop = 0;
  at("where").textContent = `${ids[index]} · ${index + 1} / ${ids.length}`;
  at("comment").value = answer(ids[index]).comment || "";
  at("previous").disabled = index === 0;
  at("next").disabled = index === ids.length - 1;
  current = 0;
  keep();
  mark();
}

function unanswered() {
  for (let step = 1; step <= ids.length; step += 1) {
    const place = (index + step) % ids.length;
    if (!whole(ids[place])) { show(place); return; }
  }
  say("Every text is answered. Save, and send the file back.");
}

function onward() {
  if (current + 1 < data.slots.length) go(current + 1);
  else if (index + 1 < ids.length) show(index + 1);
  else unanswered();
}

function save() {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([asJson()], { type: "application/json" }));
  link.download = `answers_${data.reviewer}.json`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  const left = ids.filter((id) => !whole(id)).length;
  if (left) say(`Saved, but ${left} of ${ids.length} texts are not whole yet.`, true);
  else say("Saved. Send the file back.");
}

function asJson() {
  const given = {};
  for (const id of [...ids].sort()) {
    const one = answer(id);
    given[id] = { comment: one.comment || "" };
    for (const slot of data.slots) given[id][slot.name] = one[slot.name] || "";
  }
  const { schema, subset, reviewer } = data;
  return JSON.stringify({ schema, subset, reviewer, answers: given }, null, 1) + "\n";
}

async function load(file) {
  try {
    const value = JSON.parse(await file.text());
    if (value.subset !== data.subset || value.reviewer !== data.reviewer) {
      say("That file belongs to another form.", true);
      return;
    }
    answers = {};
    take(value.answers || {});
    show(index);
    say("Loaded.");
  } catch {
    say("That file is no JSON of this form.", true);
  }
}

at("previous").addEventListener("click", () => show(index - 1));
at("next").addEventListener("click", () => show(index + 1));
at("open").addEventListener("click", unanswered);
at("save").addEventListener("click", save);
at("load").addEventListener("click", () => at("file").click());
at("file").addEventListener("change", (event) => {
  if (event.target.files[0]) load(event.target.files[0]);
  event.target.value = "";
});
at("comment").addEventListener("input", () => {
  answer(ids[index]).comment = at("comment").value;
  keep();
});

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target === at("comment")) {
    if (event.key === "Escape" || event.key === "Enter") at("comment").blur();
    return;
  }
  const slot = data.slots[current];
  const values = slot.values;
  const button = event.target instanceof HTMLButtonElement || event.target.tagName === "SUMMARY";
  if (event.key >= "1" && event.key <= "9" && values[event.key - 1]) choose(slot, values[event.key - 1]);
  else if (event.key === "0" || event.key === "n") choose(slot, data.none);
  else if (event.key === "?") choose(slot, data.unsure);
  else if (event.key === "ArrowDown") go(current + 1);
  else if (event.key === "ArrowUp") go(current - 1);
  else if (event.key === "PageDown") show(index + 1);
  else if (event.key === "PageUp") show(index - 1);
  else if (event.key === "u") unanswered();
  else if (event.key === "c") at("comment").focus();
  else if (event.key === "Enter" && !button) onward();
  else return;
  event.preventDefault();
});

show(index);
