// Rows of signals, one column each: of a live flight, or of a recording.

/** Returns the index of the last element that is not later than t; -1 if all are later. */
function findLast(times, count, t) {
  let low = 0;
  let high = count;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

class Rows {
  constructor(signals, capacity) {
    this.signals = signals;
    this.places = new Map(signals.map((signal, k) => [signal.path, k]));
    this.capacity = capacity;
    this.times = new Float64Array(capacity);
    this.columns = signals.map(() => new Float32Array(capacity));
    this.count = 0;
    this.base = 0;
  }

  has(path) {
    return this.places.has(path);
  }

  signal(path) {
    return this.signals[this.places.get(path)];
  }

  column(path) {
    return this.columns[this.places.get(path)];
  }

  /** Returns the value of a signal in a row; NaN if the signal or the row is missing. */
  value(path, row) {
    const place = this.places.get(path);
    return place === undefined || row < 0 || row >= this.count ? NaN : this.columns[place][row];
  }

  rowAt(t) {
    return findLast(this.times, this.count, t);
  }

  clear() {
    this.base += this.count;
    this.count = 0;
  }

  /** Adds a row. If the storage is full, drops the older half. If the time goes back by over 1 s, drops all rows. */
  push(time, values) {
    if (this.count && time <= this.times[this.count - 1]) {
      if (time > this.times[this.count - 1] - 1) return;
      this.clear();
    }
    if (this.count === this.capacity) this.forgetHalf();
    this.times[this.count] = time;
    for (let k = 0; k < this.columns.length; k++) this.columns[k][this.count] = values[k];
    this.count += 1;
  }

  forgetHalf() {
    const half = this.capacity >> 1;
    this.times.copyWithin(0, half);
    for (const column of this.columns) column.copyWithin(0, half);
    this.count -= half;
    this.base += half;
  }
}

/** Parses a row from the live socket: {time, clock, values}; null if the number of signals is wrong. */
export function readRow(buffer, signals) {
  if (buffer.byteLength !== 16 + 4 * signals.length) return null;
  const view = new DataView(buffer);
  return { time: view.getFloat64(0, true), clock: view.getFloat64(8, true), values: new Float32Array(buffer, 16) };
}

/** Parses a whole recording. Each row is the time (float64), then each signal (float32). */
export function readRecording(buffer, signals) {
  const stride = 2 + signals.length;
  const numbers = new Float32Array(buffer, 0, Math.floor(buffer.byteLength / 4));
  const count = Math.floor(numbers.length / stride);
  const rows = new Rows(signals, Math.max(count, 1));
  const view = new DataView(buffer);
  for (let row = 0; row < count; row++) {
    rows.times[row] = view.getFloat64(4 * stride * row, true);
    for (let k = 0; k < signals.length; k++) rows.columns[k][row] = numbers[stride * row + 2 + k];
  }
  rows.count = count;
  return rows;
}

/** Thins the rows from..to to about `most` points, and keeps every extreme. Returns {x, ys}; null: unknown value. */
export function thinRows(rows, columns, from, to, most) {
  let step = 1;
  while ((to - from) / step > most / 2) step *= 2;
  const x = [];
  const ys = columns.map(() => []);
  if (step === 1) {
    for (let row = from; row < to; row++) {
      x.push(rows.times[row]);
      columns.forEach((column, k) => ys[k].push(Number.isNaN(column[row]) ? null : column[row]));
    }
    return { x, ys };
  }
  for (let start = from - ((rows.base + from) % step); start < to; start += step) {
    const first = Math.max(start, from);
    const end = Math.min(start + step, to);
    x.push(rows.times[first], rows.times[(first + end) >> 1]);
    columns.forEach((column, k) => pushExtremes(ys[k], column, first, end));
  }
  return { x, ys };
}

function pushExtremes(y, column, first, end) {
  let low = first;
  let high = first;
  for (let row = first; row < end; row++) {
    if (column[row] < column[low] || Number.isNaN(column[low])) low = row;
    if (column[row] > column[high] || Number.isNaN(column[high])) high = row;
  }
  const ordered = low <= high ? [column[low], column[high]] : [column[high], column[low]];
  y.push(...ordered.map((value) => (Number.isNaN(value) ? null : value)));
}

/** Rows of a live flight. The newest row is shown. */
export class LiveSource {
  constructor(signals, capacity) {
    this.live = true;
    this.rows = new Rows(signals, capacity);
    this.second = null;
  }

  get row() {
    return this.rows.count - 1;
  }

  get time() {
    return this.row < 0 ? NaN : this.rows.times[this.row];
  }
}

/** Rows of one recorded flight, or of two flights for comparison. The row at the player's time is shown. */
export class RecordedSource {
  constructor(rows, second) {
    this.live = false;
    this.rows = rows;
    this.second = second ? new RecordedSource(second, null) : null;
    this.now = this.start;
  }

  get start() {
    return Math.min(this.rows.times[0], this.second ? this.second.start : Infinity);
  }

  get end() {
    return Math.max(this.rows.times[this.rows.count - 1], this.second ? this.second.end : -Infinity);
  }

  get time() {
    return this.now;
  }

  get row() {
    return Math.max(0, this.rows.rowAt(this.now));
  }

  goTo(time) {
    this.now = Math.min(this.end, Math.max(this.start, time));
    if (this.second) this.second.now = this.now;
  }
}
