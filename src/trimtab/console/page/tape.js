// Tape of angles in degrees, like a compass tape: heading, course and set-point of the craft.

import { label, readPalette, Surface } from "./canvas.js";
import { formatFixed } from "./format.js";

const DEGREES = 180 / Math.PI;
const POINTS = { 0: "N", 45: "NE", 90: "E", 135: "SE", 180: "S", 225: "SW", 270: "W", 315: "NW" };
const LONG_TICK = 12;
const SHORT_TICK = 6;

function turnedOnce(degrees) {
  return ((degrees % 360) + 360) % 360;
}

/** Returns the shortest rotation (degrees) from one angle to another, at most half a turn. */
function shortestWay(from, to) {
  return turnedOnce(to - from + 180) - 180;
}

export class Tape {
  /** `wraps`: true for a heading, which wraps after a full turn; false for an angle such as pitch. */
  constructor(canvas, wraps, name) {
    this.surface = Surface.of(canvas);
    this.wraps = wraps;
    this.name = name;
    this.span = wraps ? 150 : 24;
    this.step = wraps ? 5 : 1;
    this.named = wraps ? 15 : 4;
  }

  /** Draws the angles (rad): pointing: heading; going: course; wanted: set-point; second: heading of the second flight.
   * NaN: unknown. */
  draw({ pointing, going = NaN, wanted = NaN, second = NaN }) {
    const context = this.surface.start();
    if (!context) return;
    const colours = readPalette();
    const centre = pointing * DEGREES;
    context.font = "13px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "top";
    if (Number.isFinite(centre)) {
      this.drawScale(context, colours, centre);
      this.drawMark(context, centre, second * DEGREES, colours.soft, "ring");
      this.drawMark(context, centre, going * DEGREES, colours.good, "diamond");
      this.drawMark(context, centre, wanted * DEGREES, colours.warning, "gate");
    }
    this.drawCentre(context, colours, centre);
  }

  place(centre, degrees) {
    const away = this.wraps ? shortestWay(centre, degrees) : degrees - centre;
    return this.surface.width * (0.5 + away / this.span);
  }

  drawScale(context, colours, centre) {
    const { width, height } = this.surface;
    context.strokeStyle = colours.soft;
    context.fillStyle = colours.ink;
    context.lineWidth = 1;
    context.beginPath();
    const first = Math.ceil((centre - this.span / 2) / this.step);
    for (let k = first; k * this.step <= centre + this.span / 2; k++) {
      const degrees = k * this.step;
      const x = width * (0.5 + (degrees - centre) / this.span);
      const isNamed = degrees % this.named === 0;
      context.moveTo(x, height);
      context.lineTo(x, height - (isNamed ? LONG_TICK : SHORT_TICK));
      if (!isNamed) continue;
      const shown = this.wraps ? turnedOnce(degrees) : degrees;
      context.fillText((this.wraps && POINTS[shown]) || String(shown).replace("-", "−"), x, height - LONG_TICK - 16);
    }
    context.stroke();
  }

  drawMark(context, centre, degrees, colour, shape) {
    if (!Number.isFinite(degrees)) return;
    const { width, height } = this.surface;
    const x = Math.min(width - 8, Math.max(8, this.place(centre, degrees)));
    const y = height - 7;
    context.beginPath();
    if (shape === "diamond") {
      for (const [dx, dy] of [[0, -7], [6, 0], [0, 7], [-6, 0]]) context.lineTo(x + dx, y + dy);
    } else if (shape === "gate") {
      for (const [dx, dy] of [[-8, 7], [-8, -7], [-3, -7], [0, 0], [3, -7], [8, -7], [8, 7]]) context.lineTo(x + dx, y + dy);
    } else context.arc(x, y, 5, 0, 2 * Math.PI);
    context.closePath();
    context.lineWidth = 2;
    context.strokeStyle = colour;
    context.fillStyle = colour;
    if (shape === "diamond") context.fill();
    else context.stroke();
  }

  drawCentre(context, colours, centre) {
    const { width, height } = this.surface;
    const shown = Number.isFinite(centre) ? (this.wraps ? turnedOnce(Math.round(centre)) : centre) : NaN;
    context.fillStyle = colours.panel;
    context.fillRect(width / 2 - 58, 0, 116, 25);
    context.strokeStyle = colours.craft;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(width / 2, 26);
    context.lineTo(width / 2, height);
    context.stroke();
    context.font = "600 19px system-ui, sans-serif";
    const text = this.wraps && Number.isFinite(shown) ? String(shown).padStart(3, "0") : formatFixed(shown, 1);
    context.textAlign = "right";
    label(context, `${text}°`, width / 2 + 30, 3, colours.ink, colours.panel);
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "left";
    label(context, `${this.name}, degrees`, 8, 4, colours.soft, colours.panel);
    context.textAlign = "center";
  }
}
