"use strict";
const DATA = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);

function element(name, attributes, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value !== undefined && value !== false) made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

// What was answered survives a closed window, unless the browser keeps nothing.
const memory = {
  read(key) {
    try { return JSON.parse(localStorage.getItem(key)); } catch { return null; }
  },
  keeps(key, value) {
    try { localStorage.setItem(key, JSON.stringify(value)); return true; } catch { return false; }
  },
  drop(key) {
    try { localStorage.removeItem(key); } catch { /* there is nothing to drop */ }
  },
};

const asFile = (value) => JSON.stringify(value, null, 1) + "\n";

function download(name, value) {
  const href = URL.createObjectURL(new Blob([asFile(value)], { type: "application/json" }));
  element("a", { download: name, href }).click();
  setTimeout(() => URL.revokeObjectURL(href), 60000);
}

