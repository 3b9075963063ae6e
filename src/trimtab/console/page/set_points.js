// Set-points of signals: a number, a parameter with its history, or another signal.

export class SetPoints {
  constructor(goals, parameters, source) {
    this.goals = goals ?? {};
    this.source = source;
    this.values = new Map();
    for (const { path, slot, value } of parameters ?? []) this.note(path, slot, value);
  }

  keyOf(path, slot) {
    return slot ? `${path}.${slot}` : path;
  }

  /** Records that a parameter has this value from now on. */
  note(path, slot, value) {
    const key = this.keyOf(path, slot);
    const changes = this.values.get(key) ?? [];
    changes.push({ t: changes.length ? this.source.time : -Infinity, value });
    this.values.set(key, changes);
  }

  has(path) {
    return this.history(path) !== null;
  }

  /** Returns a function from time to a signal's set-point at this time; null if the signal has no set-point. */
  history(path) {
    const goal = this.goals[path];
    if (typeof goal === "number") return () => goal;
    if (goal === undefined || goal === null) return null;
    const changes = this.values.get(goal) ?? this.values.get(goal.replace(/\.0$/, ""));
    if (changes) return (t) => changes.findLast((change) => change.t <= t)?.value ?? changes[0].value;
    const column = this.source.rows.column(goal);
    return column ? (t) => column[this.source.rows.rowAt(t)] ?? null : null;
  }

  /** Returns the present set-point of a signal; NaN if the signal has no set-point. */
  now(path) {
    const history = this.history(path);
    return history ? Number(history(this.source.time) ?? NaN) : NaN;
  }
}
