// View of a craft that moves in three dimensions: attitude against the horizon, height, speed, and track from above.

import { readPalette, Surface } from "./canvas.js";
import { formatFixed, formatNumber, wrapDegrees } from "./format.js";
import { Tape } from "./tape.js";
import { drawTrace } from "./trace.js";
import { PlanarView } from "./view_planar.js";

const DEGREE = Math.PI / 180;
const SHOWN = 40 * DEGREE;
const LADDER = 10;
const LADDER_REACH = 0.68;
const ROLL_MARKS = [-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60];
const SYMBOL = [[-0.55, 0], [-0.2, 0], [-0.1, 0.08], [0, 0], [0.1, 0.08], [0.2, 0], [0.55, 0]];

export class SpatialView {
  /** `canvases`: {attitude, craft, tape}. */
  constructor(canvases, view, setPoint, life) {
    this.view = view;
    this.setPoint = setPoint;
    this.surface = Surface.of(canvases.attitude);
    this.plan = view.plan && new PlanarView(canvases.craft, canvases.tape, view.plan, setPoint, life);
    this.tape = this.plan?.tape ?? new Tape(canvases.tape, true, "heading");
    canvases.attitude.setAttribute("aria-label", "Artificial horizon, with altitude and speed");
  }

  get changed() {
    return this.surface.changed || this.tape.surface.changed || Boolean(this.plan?.changed);
  }

  get following() {
    return this.plan?.following ?? true;
  }

  zoom(factor) {
    this.plan?.zoom(factor);
  }

  follow(yes) {
    this.plan?.follow(yes);
  }

  fit() {
    this.plan?.fit();
  }

  /** Returns roll, pitch and yaw (rad). */
  readAngles({ rows, row }) {
    return Object.fromEntries(Object.entries(this.view.attitude).map(([name, path]) => [name, rows.value(path, row)]));
  }

  draw(source) {
    const angles = this.readAngles(source);
    if (this.plan) this.plan.draw(source);
    else this.tape.draw({ pointing: angles.yaw });
    const context = this.surface.start();
    if (!context) return;
    const colours = readPalette();
    const { width, height } = this.surface;
    const radius = Math.min(height / 2 - 10, width * 0.27);
    const centre = { x: radius + 12, y: height / 2 };
    this.drawHorizon(context, colours, angles, centre, radius);
    if (source.second) this.drawSecond(context, colours, this.readAngles(source.second), centre, radius);
    this.drawRollScale(context, colours, angles, centre, radius);
    this.drawSymbol(context, colours, centre, radius);
    const left = 2 * radius + 30;
    const shown = [["altitude", "altitude"], ["ground_speed", "ground speed"]].filter(([key]) => this.view[key]);
    const each = (height - 8) / Math.max(1, shown.length);
    shown.forEach(([key, name], k) => {
      const box = { left, top: 4 + k * each, width: width - left - 8, height: each };
      drawTrace(context, colours, source, this.view[key], name, box, this.setPoint);
    });
  }

  drawHorizon(context, colours, { roll, pitch }, { x, y }, radius) {
    context.save();
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fillStyle = colours.line;
    context.fill();
    context.clip();
    if (Number.isFinite(roll + pitch)) {
      const scale = radius / SHOWN;
      context.translate(x, y);
      context.rotate(-roll);
      context.translate(0, pitch * scale);
      const far = 2 * Math.PI * scale;
      context.fillStyle = colours.sky;
      context.fillRect(-far, -far, 2 * far, far);
      context.fillStyle = colours.earth;
      context.fillRect(-far, 0, 2 * far, far);
      context.strokeStyle = colours.ink;
      context.lineWidth = 2;
      drawSegments(context, [[-far, 0, far, 0]]);
      this.drawLadder(context, colours, pitch, scale, radius);
    }
    context.restore();
    context.strokeStyle = colours.soft;
    context.lineWidth = 1.5;
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.stroke();
  }

  drawLadder(context, colours, pitch, scale, radius) {
    const near = Math.round(pitch / DEGREE / LADDER) * LADDER;
    context.font = "12px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.textAlign = "left";
    context.lineWidth = 1;
    context.strokeStyle = colours.ink;
    for (let step = -3; step <= 3; step++) {
      const degrees = near + step * LADDER;
      if (degrees === 0 || Math.abs(degrees) > 90) continue;
      const y = -degrees * DEGREE * scale;
      const from_symbol = Math.abs(y + pitch * scale);
      if (from_symbol > LADDER_REACH * radius) continue;
      const half = radius * 0.22;
      context.setLineDash(degrees < 0 ? [5, 3] : []);
      drawSegments(context, [[-half, y, half, y]]);
      context.setLineDash([]);
      context.fillStyle = colours.ink;
      if (from_symbol > 10) context.fillText(String(Math.abs(degrees)), half + 5, y);
    }
  }

  /** Draws the horizon of the second flight as a dashed line. */
  drawSecond(context, colours, { roll, pitch }, { x, y }, radius) {
    if (!Number.isFinite(roll + pitch)) return;
    context.save();
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.clip();
    context.translate(x, y);
    context.rotate(-roll);
    context.strokeStyle = colours.panel;
    context.lineWidth = 2.5;
    context.setLineDash([6, 5]);
    const down = (pitch * radius) / SHOWN;
    drawSegments(context, [[-2 * radius, down, 2 * radius, down]]);
    context.restore();
  }

  drawRollScale(context, colours, { roll }, { x, y }, radius) {
    context.save();
    context.translate(x, y);
    context.strokeStyle = colours.ink;
    context.lineWidth = 1.5;
    for (const degrees of ROLL_MARKS) {
      const [s, c] = [Math.sin(degrees * DEGREE), Math.cos(degrees * DEGREE)];
      const inner = radius * (degrees % 30 ? 0.94 : 0.89);
      drawSegments(context, [[inner * s, -inner * c, radius * s, -radius * c]]);
    }
    if (Number.isFinite(roll)) {
      context.rotate(-roll);
      context.fillStyle = colours.craft;
      context.strokeStyle = colours.panel;
      context.lineWidth = 1.5;
      context.beginPath();
      for (const [dx, dy] of [[0, 0.88], [0.06, 0.75], [-0.06, 0.75]]) context.lineTo(dx * radius, -dy * radius);
      context.closePath();
      context.stroke();
      context.fill();
    }
    context.restore();
  }

  drawSymbol(context, colours, { x, y }, radius) {
    for (const [colour, wide] of [[colours.panel, 6], [colours.craft, 3]]) {
      context.strokeStyle = colour;
      context.lineWidth = wide;
      context.lineJoin = "round";
      context.beginPath();
      for (const [dx, dy] of SYMBOL) context.lineTo(x + dx * radius, y + dy * radius);
      context.stroke();
    }
  }

  /** Returns the readouts beside the drawing, as pairs of a name and a text. */
  read(source) {
    const { rows, row } = source;
    const { roll, pitch } = this.readAngles(source);
    const pairs = [
      ["roll, deg", formatFixed(wrapDegrees(roll), 1)],
      ["pitch, deg", formatFixed(wrapDegrees(pitch), 1)],
    ];
    for (const [key, name] of [["climb", "climb, m/s"], ["air_speed", "air, m/s"]]) {
      if (this.view[key]) pairs.push([name, formatNumber(rows.value(this.view[key], row), 3)]);
    }
    return pairs;
  }
}

function drawSegments(context, segments) {
  context.beginPath();
  for (const [ax, ay, bx, by] of segments) {
    context.moveTo(ax, ay);
    context.lineTo(bx, by);
  }
  context.stroke();
}
