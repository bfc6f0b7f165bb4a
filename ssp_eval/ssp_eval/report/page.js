"use strict";
(() => {
  const pictures = JSON.parse(document.getElementById("pictures").textContent);

  // A picture is decoded when its record is opened: a hundred of them at once would be slow.
  const show = (record) => {
    for (const image of record.querySelectorAll("img[data-frame]")) {
      const data = pictures[image.dataset.frame];
      if (data) image.src = data;
      else image.replaceWith(document.createTextNode("the frame was not kept"));
      image.removeAttribute("data-frame");
    }
  };
  const records = [...document.querySelectorAll("details.record")];
  for (const record of records) {
    record.addEventListener("toggle", () => record.open && show(record));
    if (record.open) show(record);
  }

  const cells = [...document.querySelectorAll("details.cell")];
  const follow = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (let node = target; node; node = node.parentElement) {
      if (node instanceof HTMLDetailsElement) node.open = true;
    }
    target.scrollIntoView();
  };
  addEventListener("hashchange", follow);
  follow();

  const overlay = document.getElementById("overlay");
  overlay.addEventListener("change", () => document.body.classList.toggle("bare", !overlay.checked));

  const filters = document.querySelector(".filters");
  filters.hidden = false;
  const selects = [...filters.querySelectorAll("select")];
  const apply = () => {
    const wanted = Object.fromEntries(selects.map((s) => [s.dataset.filter, s.value]));
    let shown = 0;
    for (const cell of cells) {
      let fits = ["scenario", "domain", "model"].every((k) => !wanted[k] || cell.dataset[k] === wanted[k]);
      let some = false;
      for (const record of cell.querySelectorAll("details.record")) {
        record.hidden = Boolean(wanted.stage) && record.dataset.stage !== wanted.stage;
        some ||= !record.hidden;
      }
      cell.hidden = !(fits && some);
      shown += cell.hidden ? 0 : 1;
    }
    document.getElementById("nothing").hidden = shown > 0;
  };
  for (const select of selects) select.addEventListener("change", apply);
  document.getElementById("close").addEventListener("click", () => {
    for (const details of [...records, ...cells]) details.open = false;
  });
})();
