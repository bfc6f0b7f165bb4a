// Values as people read them. A value that isn't known is a dash, never an old number.

export const DASH = "—";

export function fixed(value, digits) {
  return typeof value === "number" && Number.isFinite(value) ? value.toFixed(digits) : DASH;
}

export function signed(value, digits) {
  const text = fixed(value, digits);
  return text === DASH || value < 0 ? text.replace("-", "−") : `+${text}`;
}

export function milliseconds(seconds) {
  return typeof seconds === "number" ? fixed(seconds * 1000, 0) : DASH;
}

export function bytes(count) {
  if (typeof count !== "number") return DASH;
  const units = ["B", "kB", "MB", "GB", "TB"];
  let power = 0;
  while (count >= 1000 && power < units.length - 1) {
    count /= 1000;
    power += 1;
  }
  return `${count.toFixed(power && count < 100 ? 1 : 0)} ${units[power]}`;
}

export function duration(seconds) {
  if (typeof seconds !== "number") return DASH;
  if (seconds < 120) return `${seconds.toFixed(0)} s`;
  if (seconds < 7200) return `${(seconds / 60).toFixed(0)} min`;
  return `${(seconds / 3600).toFixed(seconds < 36000 ? 1 : 0)} h`;
}

export function clock(seconds) {
  if (typeof seconds !== "number") return DASH;
  const minutes = Math.floor(seconds / 60);
  return `${minutes}:${(seconds - 60 * minutes).toFixed(1).padStart(4, "0")}`;
}

export function words(name) {
  return name.replaceAll("_", " ");
}

// Writes only what has changed, so that an unchanged page costs nothing.
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function setClass(element, name, on) {
  if (element.classList.contains(name) !== Boolean(on)) element.classList.toggle(name, Boolean(on));
}

export function make(tag, text, className) {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = text;
  if (className) element.className = className;
  return element;
}

export const byId = (id) => document.getElementById(id);
