// View of the craft from the side: attitude, flight path, exaggerated bending, and history of altitude and speed.

import { label, readPalette, Surface } from "./canvas.js";
import { formatFixed, formatNumber, shownUnit } from "./format.js";
import { Tape } from "./tape.js";
import { drawTrace } from "./trace.js";

const DEGREES = 180 / Math.PI;
const TRACK_SHARE = 0.34;
const BEND_SHARE = 0.1;
const STATIONS = 41;
const GAINS = [1, 2, 5, 10];
const WEDGE = { top: 0.012, bottom: 0.085, engine: [0.05, 0.45] };
const FREE_BEAM = [
  { wave: 4.730041, ratio: 0.9825022 },
  { wave: 7.853205, ratio: 1.0007773 },
];

/** Returns the shape of a bending mode of a free beam at x from 0 to 1. The magnitude is 1 at both ends. */
function bendingShape({ wave, ratio }, x) {
  const b = wave * x;
  return (Math.cosh(b) + Math.cos(b) - ratio * (Math.sinh(b) + Math.sin(b))) / 2;
}

export class LongitudinalView {
  constructor(canvas, tape, view, setPoint) {
    this.surface = Surface.of(canvas);
    this.tape = new Tape(tape, false, "pitch");
    this.view = view;
    this.setPoint = setPoint;
    this.gain = GAINS.indexOf(5);
    this.largest = 1e-9;
    this.shapes = FREE_BEAM.map((mode) => Array.from({ length: STATIONS }, (_, k) => bendingShape(mode, k / (STATIONS - 1))));
    canvas.setAttribute("aria-label", "The craft from the side, with altitude and speed");
  }

  get changed() {
    return this.surface.changed || this.tape.surface.changed;
  }

  /** Changes the factor by which angles are exaggerated. */
  zoom(factor) {
    this.gain = Math.min(GAINS.length - 1, Math.max(0, this.gain + (factor > 1 ? 1 : -1)));
    this.surface.changed = true;
  }

  follow() {}

  fit() {
    this.gain = 0;
    this.surface.changed = true;
  }

  /** Returns pitch, angle of attack and flight-path angle (rad). The signals are the angle of attack, and either pitch
   * or rate of climb. */
  readAngles({ rows, row }) {
    const { alpha, theta, climb } = this.view.attitude;
    const attack = rows.value(alpha, row);
    const path = climb ? Math.asin(rows.value(climb, row) / rows.value(this.view.speed, row)) : NaN;
    const pitch = theta ? rows.value(theta, row) : attack + path;
    return { alpha: attack, theta: pitch, path: climb ? path : pitch - attack };
  }

  draw(source) {
    const angles = this.readAngles(source);
    const wanted = this.view.attitude.theta ? this.setPoint(this.view.attitude.theta) : NaN;
    const second = source.second ? this.readAngles(source.second).theta : NaN;
    this.tape.draw({ pointing: angles.theta, going: angles.path, wanted, second });
    const context = this.surface.start();
    if (!context) return;
    const colours = readPalette();
    const { width, height } = this.surface;
    const stage = height * (1 - TRACK_SHARE);
    this.drawHorizon(context, colours, stage);
    if (source.second) this.drawCraft(context, source.second, this.view.modes, colours.ghost, stage, [6, 5]);
    if (this.view.estimated) this.drawCraft(context, source, this.view.estimated, colours.warning, stage, [3, 3]);
    this.drawCraft(context, source, this.view.modes, colours.craft, stage, []);
    this.drawPath(context, angles, colours, stage);
    this.drawWords(context, colours, source, stage);
    const half = (width - 24) / 2;
    const box = { top: stage, width: half, height: height - stage - 6 };
    drawTrace(context, colours, source, this.view.altitude, "altitude", { left: 8, ...box }, this.setPoint);
    drawTrace(context, colours, source, this.view.speed, "speed", { left: 16 + half, ...box }, this.setPoint);
  }

  drawHorizon(context, colours, stage) {
    const { width } = this.surface;
    context.strokeStyle = colours.line;
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(0, stage / 2);
    context.lineTo(width, stage / 2);
    context.stroke();
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "left";
    context.textBaseline = "alphabetic";
    label(context, "level", 10, stage / 2 - 5, colours.soft, colours.panel);
  }

  /** Returns the bending of each station of the body, relative to the largest bending so far. */
  readBending(source, paths) {
    const amplitudes = ["eta1", "eta2"].map((name) => (paths ? source.rows.value(paths[name], source.row) : NaN));
    const known = amplitudes.map((value) => (Number.isFinite(value) ? value : 0));
    this.largest = Math.max(this.largest, Math.abs(known[0]), Math.abs(known[1]));
    return this.shapes[0].map((_, k) => (known[0] * this.shapes[0][k] + known[1] * this.shapes[1][k]) / this.largest);
  }

  drawCraft(context, source, paths, colour, stage, dash) {
    const { theta } = this.readAngles(source);
    if (!Number.isFinite(theta)) return;
    const bending = this.readBending(source, paths);
    const length = this.surface.width * 0.72;
    context.save();
    context.translate(this.surface.width / 2, stage / 2);
    context.rotate(-theta * GAINS[this.gain]);
    const point = (k, below) => {
      const x = k / (STATIONS - 1);
      return [(x - 0.5) * length, (below - BEND_SHARE * bending[k]) * length];
    };
    const lower = (x) => {
      const [aft, fore] = WEDGE.engine;
      const wedge = WEDGE.bottom * Math.min(1, (1 - x) / 0.55) * Math.min(1, 0.35 + x * 2.2);
      return x > aft && x < fore ? wedge + 0.02 : wedge;
    };
    context.beginPath();
    for (let k = 0; k < STATIONS; k++) context.lineTo(...point(k, -WEDGE.top));
    for (let k = STATIONS - 1; k >= 0; k--) context.lineTo(...point(k, lower(k / (STATIONS - 1))));
    context.closePath();
    context.strokeStyle = colour;
    context.fillStyle = colour;
    context.lineWidth = 2;
    context.setLineDash(dash);
    if (!dash.length) {
      context.globalAlpha = 0.18;
      context.fill();
      context.globalAlpha = 1;
    }
    context.stroke();
    context.restore();
  }

  drawPath(context, angles, colours, stage) {
    if (!Number.isFinite(angles.path)) return;
    const reach = this.surface.width * 0.44;
    const angle = -angles.path * GAINS[this.gain];
    context.save();
    context.translate(this.surface.width / 2, stage / 2);
    context.rotate(angle);
    context.strokeStyle = colours.good;
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(0, 0);
    context.lineTo(reach, 0);
    context.lineTo(reach - 11, -5);
    context.moveTo(reach, 0);
    context.lineTo(reach - 11, 5);
    context.stroke();
    context.restore();
  }

  drawWords(context, colours, source, stage) {
    const signal = source.rows.signal(this.view.modes?.eta1);
    const unit = signal ? shownUnit(signal.unit) : "";
    const words = [`angles × ${GAINS[this.gain]}`, `bending drawn large: most ${formatNumber(this.largest, 2)} ${unit}`.trim()];
    const lines = [];
    if (this.view.estimated) lines.push("dashed: estimated");
    if (source.second) lines.push("grey: second flight");
    context.font = "13px system-ui, sans-serif";
    context.textAlign = "left";
    label(context, lines.join(" · "), 10, stage - 30, colours.soft, colours.panel);
    label(context, words.join(" · "), 10, stage - 12, colours.soft, colours.panel);
  }

  /** Returns the readouts beside the drawing, as pairs of a name and a text. */
  read(source) {
    const { alpha, theta, path } = this.readAngles(source);
    return [
      ["pitch, deg", formatFixed(theta * DEGREES, 2)],
      ["attack, deg", formatFixed(alpha * DEGREES, 2)],
      ["path, deg", formatFixed(path * DEGREES, 2)],
    ];
  }
}
