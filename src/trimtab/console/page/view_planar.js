// View of the craft from above, north up: position, heading, velocity, trail, and fence.

import { label, readPalette, roundStep, Surface } from "./canvas.js";
import { formatBound, formatFixed } from "./format.js";
import { Tape } from "./tape.js";

const TRAIL_SECONDS = 45;
const TRAIL_POINTS = 500;
const LEAST_CRAFT = 34;
const ARROW_SECONDS = 1;
const MEASURED_SECONDS = 0.3;
const ELLIPSE_SCALE = Math.sqrt(5.991);
const HULL = [[0.5, 0], [0.38, 0.17], [0.15, 0.25], [-0.38, 0.25], [-0.5, 0.19], [-0.5, -0.19], [-0.38, -0.25], [0.15, -0.25], [0.38, -0.17]];

export class PlanarView {
  constructor(canvas, tape, view, setPoint, life) {
    this.surface = Surface.of(canvas);
    this.tape = new Tape(tape, true, "heading");
    this.view = view;
    this.setPoint = setPoint;
    this.centre = { north: 0, east: 0 };
    this.scale = 0;
    this.following = !view.fence;
    this.wait_to_fit = true;
    canvas.setAttribute("aria-label", "The craft from above, north up");
    canvas.addEventListener("wheel", (event) => this.turnWheel(event), { passive: false, signal: life });
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => this.press(event), { signal: life });
    canvas.addEventListener("pointermove", (event) => this.drag(event), { signal: life });
    for (const type of ["pointerup", "pointercancel"]) canvas.addEventListener(type, (event) => this.pointers.delete(event.pointerId), { signal: life });
  }

  get changed() {
    return this.surface.changed || this.tape.surface.changed;
  }

  zoom(factor, x = this.surface.width / 2, y = this.surface.height / 2) {
    const before = this.toWorld(x, y);
    this.scale = Math.min(4000, Math.max(0.5, this.scale * factor));
    const after = this.toWorld(x, y);
    if (!this.following) {
      this.centre.north += before.north - after.north;
      this.centre.east += before.east - after.east;
    }
    this.surface.changed = true;
  }

  follow(yes) {
    this.following = yes;
    this.surface.changed = true;
  }

  /** Zooms so that fence, beacons and trail are visible. */
  fit() {
    this.following = false;
    this.wait_to_fit = true;
    this.surface.changed = true;
  }

  turnWheel(event) {
    event.preventDefault();
    this.zoom(Math.exp(-0.0015 * event.deltaY), event.offsetX, event.offsetY);
  }

  press(event) {
    this.surface.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = { x: event.offsetX, y: event.offsetY };
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const spread = (point) => Math.hypot(point.x - other.x, point.y - other.y);
      this.zoom(spread(now) / Math.max(1, spread(before)), (now.x + other.x) / 2, (now.y + other.y) / 2);
    } else {
      this.following = false;
      this.centre.east -= (now.x - before.x) / this.scale;
      this.centre.north += (now.y - before.y) / this.scale;
    }
    this.pointers.set(event.pointerId, now);
    this.surface.changed = true;
  }

  toScreen(north, east) {
    const { width, height } = this.surface;
    return [width / 2 + (east - this.centre.east) * this.scale, height / 2 - (north - this.centre.north) * this.scale];
  }

  toWorld(x, y) {
    const { width, height } = this.surface;
    return { east: this.centre.east + (x - width / 2) / this.scale, north: this.centre.north - (y - height / 2) / this.scale };
  }

  readPose(source, paths) {
    const { rows, row } = source;
    return { north: rows.value(paths.north, row), east: rows.value(paths.east, row), heading: rows.value(paths.heading, row) };
  }

  draw(source) {
    const pose = this.readPose(source, this.view.pose);
    const speed = this.readSpeed(source, pose.heading);
    const second = source.second;
    this.tape.draw({
      pointing: pose.heading,
      going: Math.hypot(speed.north, speed.east) > 0.05 ? Math.atan2(speed.east, speed.north) : NaN,
      wanted: this.setPoint(this.view.pose.heading),
      second: second ? this.readPose(second, this.view.pose).heading : NaN,
    });
    const context = this.surface.start();
    if (!context) return;
    if (this.wait_to_fit) this.fitNow(source, pose);
    if (this.following && Number.isFinite(pose.north)) Object.assign(this.centre, { north: pose.north, east: pose.east });
    const colours = readPalette();
    this.drawGrid(context, colours);
    this.drawFence(context, colours);
    this.drawBeacons(context, colours);
    if (second) {
      this.drawTrail(context, second, colours.ghost, [6, 5]);
      this.drawCraft(context, this.readPose(second, this.view.pose), colours.ghost, true);
    }
    this.drawTrail(context, source, colours.craft, []);
    if (this.view.truth) this.drawCraft(context, this.readPose(source, this.view.truth), colours.soft, true);
    this.drawEllipse(context, source, pose, colours);
    this.drawCraft(context, pose, colours.craft, false);
    this.drawArrow(context, pose, speed, colours);
    this.drawLegend(context, colours, Boolean(second));
  }

  readSpeed(source, heading) {
    const { rows, row } = source;
    if (!this.view.velocity) return this.measureSpeed(source);
    const surge = rows.value(this.view.velocity?.surge, row);
    const sway = rows.value(this.view.velocity?.sway, row);
    const [c, s] = [Math.cos(heading), Math.sin(heading)];
    return { north: surge * c - sway * s, east: surge * s + sway * c, surge, sway };
  }

  /** Returns the velocity over the ground, from the change of the position. Surge and sway are unknown (NaN). */
  measureSpeed({ rows, row }) {
    const before = Math.max(0, rows.rowAt(rows.times[row] - MEASURED_SECONDS));
    const seconds = rows.times[row] - rows.times[before];
    const { north, east } = this.view.pose;
    const way = (path) => (rows.value(path, row) - rows.value(path, before)) / seconds;
    return { north: way(north), east: way(east), surge: NaN, sway: NaN };
  }

  fitNow(source, pose) {
    const norths = [];
    const easts = [];
    const add = (north, east) => Number.isFinite(north) && Number.isFinite(east) && norths.push(north) && easts.push(east);
    const { fence, beacons } = this.view;
    if (fence) fence.north.forEach((north, k) => add(north, fence.east[k]));
    for (const [north, east] of beacons ?? []) add(north, east);
    const { rows } = source;
    const step = Math.max(1, Math.floor(rows.count / TRAIL_POINTS));
    for (let row = 0; row < rows.count; row += step) add(rows.value(this.view.pose.north, row), rows.value(this.view.pose.east, row));
    if (!norths.length) add(pose.north, pose.east);
    if (!norths.length) return;
    const [low, high] = [{ north: Math.min(...norths), east: Math.min(...easts) }, { north: Math.max(...norths), east: Math.max(...easts) }];
    const { width, height } = this.surface;
    const least = 8 * (this.view.length || 0.5);
    this.scale = 0.9 * Math.min(width / Math.max(least, high.east - low.east), height / Math.max(least, high.north - low.north));
    this.centre = { north: (low.north + high.north) / 2, east: (low.east + high.east) / 2 };
    this.wait_to_fit = false;
  }

  drawGrid(context, colours) {
    const { width, height } = this.surface;
    const step = roundStep(width / this.scale, 7);
    const [low, high] = [this.toWorld(0, height), this.toWorld(width, 0)];
    context.strokeStyle = colours.line;
    context.lineWidth = 1;
    context.beginPath();
    for (let k = Math.ceil(low.east / step); k * step < high.east; k++) {
      const x = Math.round(this.toScreen(0, k * step)[0]) + 0.5;
      context.moveTo(x, 0);
      context.lineTo(x, height);
    }
    for (let k = Math.ceil(low.north / step); k * step < high.north; k++) {
      const y = Math.round(this.toScreen(k * step, 0)[1]) + 0.5;
      context.moveTo(0, y);
      context.lineTo(width, y);
    }
    context.stroke();
  }

  drawFence(context, colours) {
    const { fence } = this.view;
    if (!fence) return;
    const [left, top] = this.toScreen(fence.north[1], fence.east[0]);
    const [right, bottom] = this.toScreen(fence.north[0], fence.east[1]);
    context.strokeStyle = colours.alarm;
    context.lineWidth = 2;
    context.setLineDash([10, 5]);
    context.strokeRect(left, top, right - left, bottom - top);
    context.setLineDash([]);
  }

  drawBeacons(context, colours) {
    context.strokeStyle = colours.ink;
    context.lineWidth = 1.5;
    for (const [north, east] of this.view.beacons ?? []) {
      const [x, y] = this.toScreen(north, east);
      context.beginPath();
      for (const [dx, dy] of [[0, -6], [5.5, 4], [-5.5, 4]]) context.lineTo(x + dx, y + dy);
      context.closePath();
      context.stroke();
    }
  }

  drawTrail(context, source, colour, dash) {
    const { rows, row } = source;
    if (row < 1) return;
    const [norths, easts] = [rows.column(this.view.pose.north), rows.column(this.view.pose.east)];
    if (!norths || !easts) return;
    const first = Math.max(0, rows.rowAt(rows.times[row] - TRAIL_SECONDS));
    const step = Math.max(1, Math.ceil((row - first) / TRAIL_POINTS));
    context.strokeStyle = colour;
    context.lineWidth = 2;
    context.globalAlpha = 0.55;
    context.setLineDash(dash);
    context.beginPath();
    let broken = true;
    for (let k = first - ((rows.base + first) % step); k <= row; k += step) {
      if (k < 0) continue;
      const [x, y] = this.toScreen(norths[k], easts[k]);
      if (Number.isNaN(x) || Number.isNaN(y)) broken = true;
      else {
        if (broken) context.moveTo(x, y);
        else context.lineTo(x, y);
        broken = false;
      }
    }
    context.stroke();
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  drawCraft(context, pose, colour, hollow) {
    if (!Number.isFinite(pose.north + pose.east + pose.heading)) return;
    const [x, y] = this.toScreen(pose.north, pose.east);
    const size = Math.max(LEAST_CRAFT, (this.view.length || 0.5) * this.scale);
    context.save();
    context.translate(x, y);
    context.rotate(pose.heading - Math.PI / 2);
    context.beginPath();
    for (const [along, across] of HULL) context.lineTo(along * size, across * size);
    context.closePath();
    context.lineWidth = 2;
    context.strokeStyle = colour;
    context.fillStyle = colour;
    if (hollow) context.setLineDash([4, 3]);
    else {
      context.globalAlpha = 0.25;
      context.fill();
      context.globalAlpha = 1;
    }
    context.stroke();
    context.beginPath();
    context.moveTo(0, 0);
    context.lineTo(0.5 * size, 0);
    context.moveTo(-0.45 * size, -0.13 * size);
    context.lineTo(-0.45 * size, 0.13 * size);
    context.stroke();
    context.restore();
  }

  drawArrow(context, pose, speed, colours) {
    const length = Math.hypot(speed.north, speed.east) * ARROW_SECONDS * this.scale;
    if (!(length > 4)) return;
    const [x, y] = this.toScreen(pose.north, pose.east);
    const [ex, ey] = this.toScreen(pose.north + speed.north * ARROW_SECONDS, pose.east + speed.east * ARROW_SECONDS);
    const angle = Math.atan2(ey - y, ex - x);
    context.strokeStyle = colours.good;
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(ex, ey);
    context.lineTo(ex - 10 * Math.cos(angle - 0.45), ey - 10 * Math.sin(angle - 0.45));
    context.moveTo(ex, ey);
    context.lineTo(ex - 10 * Math.cos(angle + 0.45), ey - 10 * Math.sin(angle + 0.45));
    context.stroke();
  }

  /** Draws the 95 % confidence ellipse of the position. */
  drawEllipse(context, source, pose, colours) {
    const paths = this.view.covariance;
    if (!paths) return;
    const [nn, ne, ee] = ["nn", "ne", "ee"].map((name) => source.rows.value(paths[name], source.row));
    const middle = (nn + ee) / 2;
    const spread = Math.hypot((nn - ee) / 2, ne);
    if (!(middle > 0) || !Number.isFinite(spread + pose.north)) return;
    const [x, y] = this.toScreen(pose.north, pose.east);
    const radius = (variance) => ELLIPSE_SCALE * Math.sqrt(Math.max(0, variance)) * this.scale;
    context.beginPath();
    context.ellipse(x, y, radius(middle + spread), radius(middle - spread), Math.atan2(2 * ne, nn - ee) / 2 - Math.PI / 2, 0, 2 * Math.PI);
    context.strokeStyle = colours.craft;
    context.lineWidth = 1.5;
    context.setLineDash([2, 3]);
    context.stroke();
    context.setLineDash([]);
  }

  drawLegend(context, colours, hasSecond) {
    const { width, height } = this.surface;
    const metres = roundStep(width / this.scale, 6);
    if (!Number.isFinite(metres)) return;
    const length = metres * this.scale;
    const [x, y] = [14, height - 14];
    context.strokeStyle = colours.ink;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(x, y - 6);
    context.lineTo(x, y);
    context.lineTo(x + length, y);
    context.lineTo(x + length, y - 6);
    context.stroke();
    context.font = "13px system-ui, sans-serif";
    context.textBaseline = "alphabetic";
    context.textAlign = "left";
    label(context, `${formatBound(metres)} m`, x + 6, y - 5, colours.ink, colours.panel);
    const words = ["arrow: way in 1 s"];
    if (this.view.covariance) words.push("dotted: 95 %");
    if (this.view.truth) words.push("dashed: truth");
    if (hasSecond) words.push("grey: second flight");
    context.textAlign = "right";
    const text = words.join(" · ");
    const meets = context.measureText(text).width > width - length - 60;
    const lines = context.measureText(text).width > width - 20 ? [words.slice(0, 2).join(" · "), words.slice(2).join(" · ")] : [text];
    lines.forEach((line, k) => label(context, line, width - 10, y - (meets ? 26 : 0) - 18 * (lines.length - 1 - k), colours.soft, colours.panel));
    context.textAlign = "left";
    label(context, "↑ N", 12, y - 26, colours.soft, colours.panel);
  }

  /** Returns the readouts beside the drawing, as pairs of a name and a text. */
  read(source) {
    const pose = this.readPose(source, this.view.pose);
    const speed = this.readSpeed(source, pose.heading);
    return [
      ["north, m", formatFixed(pose.north, 2)],
      ["east, m", formatFixed(pose.east, 2)],
      ["surge, m/s", formatFixed(speed.surge, 2)],
      ["sway, m/s", formatFixed(speed.sway, 2)],
    ];
  }
}
