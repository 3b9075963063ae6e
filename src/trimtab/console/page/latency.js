// Latency from the measurement of the state to its display: from the time (server's clock) in a row of signals to the
// end of the animation frame in which that row was drawn.

import { readClock } from "./socket.js";

const KEPT_SECONDS = 10;

function quantile(sorted, share) {
  return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : NaN;
}

export class FramesTiming {
  constructor(clock) {
    this.clock = clock;
    this.samples = [];
    this.row_times = [];
    this.frame_times = [];
    this.newest = NaN;
    this.computed_at = -Infinity;
    this.numbers = { median: NaN, p99: NaN };
    this.after = new MessageChannel();
    this.after.port1.onmessage = (event) => this.noteShown(event.data);
  }

  noteRow(clock) {
    this.newest = clock;
    this.row_times.push(readClock());
  }

  /** Records the end of a frame. The posted message arrives after the browser has processed the frame. */
  noteFrame(drewRow) {
    this.frame_times.push(readClock());
    if (drewRow) this.after.port2.postMessage(this.newest);
  }

  noteShown(clock) {
    if (!Number.isFinite(this.clock.offset)) return;
    const now = readClock();
    this.samples.push({ at: now, seconds: now + this.clock.offset - clock });
  }

  forgetOld() {
    const oldest = readClock() - KEPT_SECONDS;
    this.samples = this.samples.filter((sample) => sample.at > oldest);
    this.row_times = this.row_times.filter((at) => at > oldest);
    this.frame_times = this.frame_times.filter((at) => at > oldest);
  }

  compute() {
    if (readClock() - this.computed_at < 0.2) return this.numbers;
    this.computed_at = readClock();
    this.forgetOld();
    const sorted = this.samples.map((sample) => sample.seconds).sort((a, b) => a - b);
    this.numbers = { median: quantile(sorted, 0.5), p99: quantile(sorted, 0.99) };
    return this.numbers;
  }

  /** Median latency (s) of the last ten seconds, from state to display. */
  get median() {
    return this.compute().median;
  }

  /** 99 % quantile (s) of the latency of the last ten seconds, from state to display. */
  get p99() {
    return this.compute().p99;
  }

  get count() {
    return this.samples.length;
  }

  rate(times) {
    return times.length < 2 ? NaN : (times.length - 1) / (times.at(-1) - times[0]);
  }

  get rows_per_second() {
    return this.rate(this.row_times);
  }

  get frames_per_second() {
    return this.rate(this.frame_times);
  }
}
