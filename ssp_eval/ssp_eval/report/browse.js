"use strict";
(() => {
  const data = JSON.parse(document.getElementById("rows").textContent);
  const PAGE_ROWS = 50;
  const words = (text) => text.replaceAll("_", " ");
  const COLUMNS = data.scores.length + 5;  // scenario, domain, model, risk, first failures
  const at = (name) => data.scores.indexOf(name);
  const cells = data.rows.map(
    ([id, scenario, domain, model, status, admission, control, stages, scores, rl, reason, constant]) => ({
      id, scenario: data.scenario[scenario], domain: data.domain[domain], model: data.model[model],
      status, admission, control: Boolean(control), stages, scores, rl, reason, constant,
    }));
  for (const cell of cells) {
    cell.text = words(`${cell.scenario} ${cell.domain} ${cell.model} ${cell.status} ${cell.admission} ` +
      `${cell.control ? "control" : ""} ${cell.reason} ${cell.id}`).toLowerCase();
  }
  const known = new Map(cells.map((cell) => [cell.id, cell]));
  const one = (id) => document.getElementById(id);
  const make = (tag, text, name) => {
    const node = document.createElement(tag);
    if (text) node.textContent = text;
    if (name) node.className = name;
    return node;
  };

  // -- which cells, and in which order --
  let found = cells, first = 0, sorted = "", down = true;
  const selects = [...document.querySelectorAll("select[data-filter]")];
  const wanted = () => Object.fromEntries(selects.map((s) => [s.dataset.filter, s.value]));
  const kind = one("kind");
  // A control that is asked for by its name is shown, whichever kind is.
  const ofKind = (cell, by) => !kind?.value || Boolean(by.model) || cell.control === (kind.value === "1");
  const fits = (cell, by, tokens) => ofKind(cell, by) &&
    ["scenario", "domain", "model", "status", "admission"].every((k) => !by[k] || cell[k] === by[k]) &&
    (!by.stage || (by.stage === "-" ? /^-+$/.test(cell.stages) : cell.stages.includes(by.stage))) &&
    tokens.every((token) => cell.text.includes(token));
  const failing = (cell, stage) => [...cell.stages].filter((c) => (stage ? c === stage : c !== "-")).length;
  const value = (cell, stage) => {
    if (["scenario", "domain", "model"].includes(sorted)) return cell[sorted];
    if (!cell.scores) return null;
    if (sorted === "risk") return cell.rl;
    if (sorted === "failures") return failing(cell, stage);
    return cell.scores[at(sorted)];
  };
  const apply = () => {
    const by = wanted();
    const tokens = words(one("search").value).toLowerCase().split(/\s+/).filter(Boolean);
    found = cells.filter((cell) => fits(cell, by, tokens));
    if (sorted) {
      const stage = by.stage === "-" ? "" : by.stage;
      const keyed = found.map((cell) => [value(cell, stage), cell]);
      // What has no value comes last, whichever way.
      keyed.sort(([a], [b]) => (a === null) - (b === null) || (a < b ? -1 : a > b ? 1 : 0) * (down ? -1 : 1));
      found = keyed.map(([, cell]) => cell);
    }
    first = 0;
    draw();
  };

  // -- rows --
  const shown = one("shown");
  const number = (cell, name, digits) => {
    const score = cell.scores ? cell.scores[at(name)] : null;
    const node = make("td", score === null ? "–" : score.toFixed(digits), "num bar");
    if (score !== null) node.style.setProperty("--v", score);
    if (name === "ivcs" && cell.constant !== null) {
      node.title = `best blind constant ${cell.constant.toFixed(3)}`;
      // Both are rounded to six digits.
      if (!cell.control && score < cell.constant) node.textContent += " ↓";
    }
    return node;
  };
  const strip = (stages) => {
    const node = make("span", "", "strip");
    for (const stage of stages) {
      node.append(make("i", stage === "-" ? "" : String(Number(stage) + 1), stage === "-" ? "pass" : "fail"));
    }
    return node;
  };
  const row = (cell) => {
    const line = make("tr", "", "cell");
    line.dataset.id = cell.id;
    line.tabIndex = 0;
    line.setAttribute("aria-expanded", "false");
    line.append(make("td", words(cell.scenario)), make("td", cell.domain));
    const mark = { unpaired: " †", unaudited: " ‡" }[cell.admission] ?? "";
    line.append(make("td", cell.model + (cell.control ? " (control)" : "") + mark));
    if (!cell.scores) {
      const why = make("td", `${cell.status}: ${cell.reason || "no reason given"}`, "refused");
      why.colSpan = COLUMNS - 3;
      line.append(why);
      return line;
    }
    const scores = data.scores.map((name) => number(cell, name, name === "ivcs" ? 3 : 2));
    line.append(...scores.slice(0, data.before_risk));
    line.append(make("td", cell.rl === null ? "F" : `S@${cell.rl.toFixed(2)}`, "num"));
    line.append(...scores.slice(data.before_risk));
    const last = make("td");
    last.append(strip(cell.stages));
    line.append(last);
    return line;
  };
  const all = () => {
    const by = wanted();
    return kind?.value && !by.model ? cells.filter((cell) => ofKind(cell, by)).length : cells.length;
  };
  const draw = () => {
    const until = Math.min(first + PAGE_ROWS, found.length);
    shown.replaceChildren(...found.slice(first, until).map(row));
    const out = { refused: 0, failed: 0 };
    for (const cell of found) if (cell.status in out) out[cell.status] += 1;
    one("count").textContent = found.length === 0 ? "No cell matches these filters." :
      `${found.length} of ${all()} cells` +
      (out.refused ? `, ${out.refused} refused` : "") + (out.failed ? `, ${out.failed} failed` : "");
    one("place").textContent = found.length ? `${first + 1} to ${until}` : "";
    one("previous").disabled = first === 0;
    one("next").disabled = until >= found.length;
  };

  // -- details, each from a file of its own --
  const html = new Map(), waiting = new Map();
  window.sspCell = (id, text) => html.set(id, text);
  const load = (id) => {
    if (html.has(id)) return Promise.resolve();
    if (!waiting.has(id)) {
      waiting.set(id, new Promise((done, failed) => {
        const script = document.createElement("script");
        script.src = `report/cells/${encodeURIComponent(id)}.js`;
        script.onload = done;
        script.onerror = failed;
        document.head.append(script);
      }).finally(() => waiting.delete(id)));
    }
    return waiting.get(id);
  };
  const picture = (record) => {
    for (const image of record.querySelectorAll("img[data-src]")) {
      image.src = image.dataset.src;
      image.removeAttribute("data-src");
    }
  };
  const toggle = async (line, keep) => {
    const next = line.nextElementSibling;
    if (next?.classList.contains("inside")) {
      if (!keep) {
        next.remove();
        line.setAttribute("aria-expanded", "false");
      }
      return;
    }
    const inside = make("tr", "", "inside"), whole = make("td"), place = make("div", "loading …");
    whole.colSpan = COLUMNS;
    whole.append(place);
    inside.append(whole);
    line.after(inside);
    line.setAttribute("aria-expanded", "true");
    const id = line.dataset.id;
    try {
      await load(id);
      place.innerHTML = html.get(id);
    } catch {
      place.textContent = `report/cells/${id}.js can't be read; write the report again.`;
      return;
    }
    for (const record of place.querySelectorAll("details.record")) {
      record.addEventListener("toggle", () => record.open && picture(record));
    }
    const by = wanted().stage;
    const stages = known.get(id).stages;
    place.querySelectorAll("details.record").forEach((record, index) => {
      record.classList.toggle("aside", Boolean(by) && stages[index] !== by);
    });
  };
  shown.addEventListener("click", (event) => {
    const line = event.target.closest("tr.cell");
    if (line) toggle(line);
  });
  shown.addEventListener("keydown", (event) => {
    if ((event.key === "Enter" || event.key === " ") && event.target.matches("tr.cell")) {
      event.preventDefault();
      toggle(event.target);
    }
  });

  // -- an address that names a cell or a record of it --
  const follow = async () => {
    const name = decodeURIComponent(location.hash.slice(1));
    const cell = known.get(name) ?? known.get(name.replace(/-\d+$/, ""));
    if (!cell) return;
    if (!found.includes(cell)) {
      reset();
      if (kind && cell.control) kind.value = "1";
      apply();
    }
    first = Math.floor(found.indexOf(cell) / PAGE_ROWS) * PAGE_ROWS;
    draw();
    const line = [...shown.children].find((node) => node.dataset.id === cell.id);
    await toggle(line, true);
    const record = document.getElementById(name);
    if (record instanceof HTMLDetailsElement) record.open = true;
    (record ?? line).scrollIntoView();
  };
  const reset = () => {
    for (const select of selects) select.value = "";
    if (kind) kind.value = "0";
    one("search").value = "";
    apply();
  };

  for (const select of kind ? [...selects, kind] : selects) select.addEventListener("change", apply);
  one("search").addEventListener("input", apply);
  one("reset").addEventListener("click", reset);
  const turn = (by) => {
    first += by * PAGE_ROWS;
    draw();
  };
  one("previous").addEventListener("click", () => turn(-1));
  one("next").addEventListener("click", () => turn(1));
  for (const button of document.querySelectorAll("button[data-sort]")) {
    button.addEventListener("click", () => {
      const key = button.dataset.sort;
      down = sorted === key ? !down : !["scenario", "domain", "model"].includes(key);
      sorted = key;
      for (const other of document.querySelectorAll("th[aria-sort]")) other.removeAttribute("aria-sort");
      button.parentElement.setAttribute("aria-sort", down ? "descending" : "ascending");
      apply();
    });
  }
  const overlay = one("overlay");
  overlay.addEventListener("change", () => document.body.classList.toggle("bare", !overlay.checked));
  addEventListener("hashchange", follow);
  apply();
  follow();
})();
