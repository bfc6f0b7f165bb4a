const store = `ssp-review ${DATA.subset} ${DATA.reviewer}`;
const ids = DATA.texts.map((one) => one.id);
let answers = {};
let index = 0;
let current = 0;

const kept = memory.read(store) || {};
take(kept.answers || {});
index = Math.min(Math.max(kept.index || 0, 0), ids.length - 1);

function take(given) {
  for (const id of ids) {
    const one = given[id];
    if (typeof one !== "object" || one === null) continue;
    answers[id] = {};
    for (const slot of DATA.slots) {
      const allowed = [...slot.values, DATA.none, DATA.unsure];
      const parts = String(one[slot.name] ?? "").split("+").filter((part) => allowed.includes(part));
      if (parts.length) answers[id][slot.name] = parts.join("+");
    }
    if (typeof one.comment === "string" && one.comment) answers[id].comment = one.comment;
  }
}

function keep() {
  if (!memory.keeps(store, { answers, index })) {
    say("This browser keeps no answers: save them before you close the window.", true);
  }
}

function say(text, wrong = false) {
  $("say").textContent = text;
  $("say").className = wrong ? "wrong" : "";
  clearTimeout(say.timer);
  say.timer = setTimeout(() => { $("say").textContent = ""; }, wrong ? 8000 : 3000);
}

const answer = (id) => (answers[id] ||= {});
const chosen = (slot) => (answer(ids[index])[slot.name] || "").split("+").filter(Boolean);
const whole = (id) => DATA.slots.every((slot) => (answers[id] || {})[slot.name]);

function choose(slot, value) {
  let now = chosen(slot);
  if (now.includes(value)) {
    now = now.filter((one) => one !== value);
  } else if (slot.several && !DATA.alone.includes(value)) {
    now = [...now.filter((one) => !DATA.alone.includes(one)), value];
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
const fields = DATA.slots.map((slot, number) => {
  const many = element("small", {}, slot.name + (slot.several ? ", any number" : ""));
  const choices = element("div", { class: "choices" });
  const field = element("fieldset", {}, element("legend", {}, slot.title, many), choices);
  const inputs = new Map();
  [...slot.values, DATA.none, DATA.unsure].forEach((value, place) => {
    const input = element("input", { type: "checkbox", "aria-label": `${slot.name}: ${value}` });
    input.addEventListener("change", () => { go(number); choose(slot, value); });
    const key = value === DATA.none ? "0" : value === DATA.unsure ? "?" : String(place + 1);
    const kind = DATA.alone.includes(value) && "alone";
    choices.append(element("label", { class: kind }, input, element("kbd", {}, key), value));
    inputs.set(value, input);
  });
  field.addEventListener("pointerdown", () => go(number));
  field.addEventListener("focusin", () => go(number));
  $("slots").append(field);
  return { field, inputs };
});

function mark() {
  DATA.slots.forEach((slot, number) => {
    const now = chosen(slot);
    fields[number].inputs.forEach((input, value) => { input.checked = now.includes(value); });
    fields[number].field.classList.toggle("answered", now.length > 0);
    fields[number].field.classList.toggle("current", number === current);
  });
  $("rule").textContent = DATA.slots[current].rule;
  const done = ids.filter(whole).length;
  $("done").textContent = `${done} of ${ids.length} answered`;
  $("fill").style.width = `${(100 * done) / ids.length}%`;
  $("fill").parentElement.setAttribute("aria-valuenow", done);
}

function go(number) {
  current = Math.min(Math.max(number, 0), DATA.slots.length - 1);
  mark();
}

function show(number) {
  index = Math.min(Math.max(number, 0), ids.length - 1);
  $("text").textContent = DATA.texts[index].text;
  $("text").scrollTop = 0;
  $("where").textContent = `${ids[index]} · ${index + 1} / ${ids.length}`;
  $("comment").value = answer(ids[index]).comment || "";
  $("previous").disabled = index === 0;
  $("next").disabled = index === ids.length - 1;
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
  if (current + 1 < DATA.slots.length) go(current + 1);
  else if (index + 1 < ids.length) show(index + 1);
  else unanswered();
}

function save() {
  download(`answers_${DATA.reviewer}.json`, given());
  const left = ids.filter((id) => !whole(id)).length;
  if (left) say(`Saved, but ${left} of ${ids.length} texts are not whole yet.`, true);
  else say("Saved. Send the file back.");
}

function given() {
  const all = {};
  for (const id of [...ids].sort()) {
    const one = answer(id);
    all[id] = { comment: one.comment || "" };
    for (const slot of DATA.slots) all[id][slot.name] = one[slot.name] || "";
  }
  const { schema, subset, reviewer } = DATA;
  return { schema, subset, reviewer, answers: all };
}

async function load(file) {
  try {
    const value = JSON.parse(await file.text());
    if (value.subset !== DATA.subset || value.reviewer !== DATA.reviewer) {
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

$("previous").addEventListener("click", () => show(index - 1));
$("next").addEventListener("click", () => show(index + 1));
$("open").addEventListener("click", unanswered);
$("save").addEventListener("click", save);
$("load").addEventListener("click", () => $("file").click());
$("file").addEventListener("change", (event) => {
  if (event.target.files[0]) load(event.target.files[0]);
  event.target.value = "";
});
$("comment").addEventListener("input", () => {
  answer(ids[index]).comment = $("comment").value;
  keep();
});

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target === $("comment")) {
    if (event.key === "Escape" || event.key === "Enter") $("comment").blur();
    return;
  }
  const slot = DATA.slots[current];
  const values = slot.values;
  const button = event.target instanceof HTMLButtonElement || event.target.tagName === "SUMMARY";
  if (event.key >= "1" && event.key <= "9" && values[event.key - 1]) choose(slot, values[event.key - 1]);
  else if (event.key === "0" || event.key === "n") choose(slot, DATA.none);
  else if (event.key === "?") choose(slot, DATA.unsure);
  else if (event.key === "ArrowDown") go(current + 1);
  else if (event.key === "ArrowUp") go(current - 1);
  else if (event.key === "PageDown") show(index + 1);
  else if (event.key === "PageUp") show(index - 1);
  else if (event.key === "u") unanswered();
  else if (event.key === "c") $("comment").focus();
  else if (event.key === "Enter" && !button) onward();
  else return;
  event.preventDefault();
});

show(index);
