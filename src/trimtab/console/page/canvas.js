// Canvases: the right number of pixels, and the colours of the page's theme.

const NAMES = ["ground", "panel", "ink", "soft", "line", "alarm", "warning", "good", "craft", "ghost", "sky", "earth"];
const SERIES = 6;
const surfaces = new WeakMap();
let palette = null;

/** The theme's colours by name, and `series`, a list. */
export function readPalette() {
  if (!palette) {
    const style = getComputedStyle(document.documentElement);
    palette = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    palette.series = Array.from({ length: SERIES }, (_, k) => style.getPropertyValue(`--s${k + 1}`).trim());
  }
  return palette;
}

/** Forgets the colours: the theme has changed. */
export function forgetPalette() {
  palette = null;
}

/** A canvas that follows its element's size; `changed` says that all has to be drawn again. */
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

  /** The one surface of a canvas, whoever draws on it. */
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

  /** Clears it and gives its context; null while it isn't shown. */
  start() {
    this.changed = false;
    if (!this.width || !this.height) return null;
    this.context.clearRect(0, 0, this.width, this.height);
    return this.context;
  }
}

/** A round step (1, 2 or 5 times a power of ten) of which about `count` fit into a span. */
export function roundStep(span, count) {
  const raw = span / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= raw * 0.999);
}

/** Writes text with a border of the ground's colour, legible on lines. */
export function label(context, text, x, y, colour, ground) {
  context.lineWidth = 4;
  context.lineJoin = "round";
  context.strokeStyle = ground;
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}
