// Canvases with the resolution of the screen, and the colours of the page's theme.

const NAMES = ["ground", "panel", "ink", "soft", "line", "alarm", "warning", "good", "craft", "ghost", "sky", "earth"];
const SERIES = 6;
const surfaces = new WeakMap();
let palette = null;

/** Returns the colours of the theme by name, and under `series` the list of colours of curves. */
export function readPalette() {
  if (!palette) {
    const style = getComputedStyle(document.documentElement);
    palette = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    palette.series = Array.from({ length: SERIES }, (_, k) => style.getPropertyValue(`--s${k + 1}`).trim());
  }
  return palette;
}

/** Discards the stored colours after a change of the theme. */
export function forgetPalette() {
  palette = null;
}

/** Canvas that follows the size of its element. `changed` is true if everything must be drawn again. */
export class Surface {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.width = 0;
    this.height = 0;
    this.changed = true;
    new ResizeObserver(() => this.fit()).observe(canvas);
    this.fit();
  }

  /** Returns the surface of a canvas. All users of a canvas share one surface. */
  static of(canvas) {
    if (!surfaces.has(canvas)) surfaces.set(canvas, new Surface(canvas));
    return surfaces.get(canvas);
  }

  fit() {
    const ratio = window.devicePixelRatio || 1;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = Math.round(this.width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.changed = true;
  }

  /** Clears the canvas and returns its drawing context; null while the canvas is not shown. */
  start() {
    this.changed = false;
    if (!this.width || !this.height) return null;
    this.context.clearRect(0, 0, this.width, this.height);
    return this.context;
  }
}

/** Returns a round step (1, 2 or 5 times a power of ten), so that about `count` steps fit into a span. */
export function roundStep(span, count) {
  const raw = span / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= raw * 0.999);
}

/** Writes text with a border in the background colour, so that the text is legible on lines. */
export function label(context, text, x, y, colour, ground) {
  context.lineWidth = 4;
  context.lineJoin = "round";
  context.strokeStyle = ground;
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}
