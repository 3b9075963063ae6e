// Formats of numbers, units and names: degrees on the page, radians in the messages.

const DEGREES = 180 / Math.PI;
const SHOWN_UNITS = { rad: "deg", "rad/s": "deg/s", "rad/s^2": "deg/s²", "m/s^2": "m/s²", "1": "" };

/** Returns the factor that converts a unit of the messages to the unit that is shown. */
export function shownFactor(unit) {
  return unit === "rad" || unit === "rad/s" || unit === "rad/s^2" ? DEGREES : 1;
}

export function shownUnit(unit) {
  return SHOWN_UNITS[unit] ?? unit ?? "";
}

/** Converts an angle (rad) to degrees, wrapped to (-180, 180]. */
export function wrapDegrees(angle) {
  const degrees = (angle * DEGREES) % 360;
  return degrees > 180 ? degrees - 360 : degrees <= -180 ? degrees + 360 : degrees;
}

/** Formats a number with about `digits` significant digits, without an exponent for common sizes. */
export function formatNumber(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 10 ** -digits)) return value.toExponential(2).replace("-", "−");
  const before = size >= 1 ? Math.floor(Math.log10(size)) + 1 : 1;
  return writeMinus(value.toFixed(Math.max(0, digits - before)));
}

/** Formats a number with a fixed number of decimals. */
export function formatFixed(value, decimals) {
  return Number.isFinite(value) ? writeMinus(value.toFixed(decimals)) : "–";
}

/** Replaces a hyphen by a minus sign, and removes the sign of a zero. */
function writeMinus(text) {
  return /^-[0.]*$/.test(text) ? text.slice(1) : text.replace("-", "−");
}

/** Formats a number that does not change, such as a bound, without trailing zeros. */
export function formatBound(value) {
  const text = formatNumber(value, 3);
  return text.includes(".") && !text.includes("e") ? text.replace(/\.?0+$/, "") : text;
}

/** Formats a number with three significant digits relative to `size`, so that noise about zero stays short. */
export function formatBeside(value, size) {
  const power = size > 0 ? Math.floor(Math.log10(size)) : 0;
  return power < -5 || power > 6 ? formatNumber(value, 3) : formatFixed(value, Math.min(6, Math.max(0, 2 - power)));
}

/** Formats the value of a signal without the unit: a mode by its name, a flag as yes or no, an angle in degrees.
 * `size`: largest magnitude of the signal so far. */
export function formatSignal(signal, value, size) {
  if (Number.isNaN(value)) return "–";
  if (signal.modes) return signal.modes[Math.round(value)] ?? String(value);
  if (signal.kind === "flag") return value ? "yes" : "no";
  if (signal.kind === "angle") return formatFixed(wrapDegrees(value), 1);
  if (signal.kind === "count") return value.toFixed(0);
  return formatBeside(value * shownFactor(signal.unit), size * shownFactor(signal.unit));
}

export function formatMs(seconds, decimals = 0) {
  return formatFixed(seconds === null ? NaN : 1000 * seconds, decimals);
}

/** Returns the last words of each path, as many as are needed to distinguish the paths. */
export function shortPaths(paths) {
  for (let words = 1; words < 9; words++) {
    const short = paths.map((path) => path.split(".").slice(/\.\d+$/.test(path) ? -words - 1 : -words).join("."));
    if (new Set(short).size === short.length) return short;
  }
  return paths;
}

/** Returns true if a text contains all words of a search. */
export function matches(search, text) {
  const lower = text.toLowerCase();
  return search.toLowerCase().split(/\s+/).every((word) => lower.includes(word));
}

/** Creates an HTML element: build("button", {class: "quiet", text: "Close"}, child, …). */
export function build(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "text") element.textContent = value;
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

/** Writes a text only if it has changed, to avoid a new layout. */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}
