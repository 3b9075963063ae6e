// Inputs that move the stick: keys with ramps, the touch pad, a gamepad. The input that was used last has effect.

const RISE_PER_SECOND = 2.5;
const FALL_PER_SECOND = 5;
const DEAD_ZONE = 0.12;
const TOUCH_DEAD_ZONE = 0.06;
const KEYS = {
  ArrowUp: ["forward", 1], KeyW: ["forward", 1], ArrowDown: ["forward", -1], KeyS: ["forward", -1],
  ArrowRight: ["turn", 1], KeyD: ["turn", 1], ArrowLeft: ["turn", -1], KeyA: ["turn", -1],
};
const BUTTONS = { 0: "take", 1: "stop", 3: "mode" };

function limit(value) {
  return Math.min(1, Math.max(-1, value));
}

/** Removes the dead zone from an axis value. The result is again from -1 to 1. */
function leaveDeadZone(value, zone) {
  const size = Math.abs(value);
  return size <= zone ? 0 : (Math.sign(value) * (Math.min(1, size) - zone)) / (1 - zone);
}

/** Moves a value towards a goal, at most as fast as the ramp allows. */
function ramp(value, goal, seconds) {
  const falls = Math.abs(goal) < Math.abs(value) || goal * value < 0;
  const most = (falls ? FALL_PER_SECOND : RISE_PER_SECOND) * seconds;
  return value + Math.min(most, Math.max(-most, goal - value));
}

/** Returns true if the element that has the focus uses the arrow keys itself. */
function keepsArrows(target) {
  return target instanceof HTMLInputElement || target instanceof HTMLSelectElement || target instanceof HTMLTextAreaElement;
}

export class StickInputs {
  /** `flies`: function that returns true while keys move the craft. `press`: function that is called with take, stop
   * or mode when a gamepad button is pressed. */
  constructor(pad, flies, press) {
    this.pad = pad;
    this.flies = flies;
    this.press = press;
    this.device = "keys";
    this.keys = new Set();
    this.axes = { forward: 0, turn: 0 };
    this.touch = null;
    this.gamepad = null;
    this.held = new Set();
    window.addEventListener("keydown", (event) => this.readKey(event), { capture: true });
    window.addEventListener("keyup", (event) => this.keys.delete(event.code), { capture: true });
    window.addEventListener("blur", () => this.keys.clear());
    pad.addEventListener("pointerdown", (event) => this.readTouch(event, true));
    pad.addEventListener("pointermove", (event) => this.touch && this.readTouch(event, false));
    for (const type of ["pointerup", "pointercancel"]) pad.addEventListener(type, () => this.leaveTouch());
  }

  /** Releases all inputs. If the gamepad is disconnected, the keys become the active input. */
  centre() {
    if (!this.present) this.device = "keys";
    this.keys.clear();
    this.touch = null;
    this.axes = { forward: 0, turn: 0 };
  }

  readKey(event) {
    if (!(event.code in KEYS) || event.ctrlKey || event.metaKey || event.altKey) return;
    if (!this.flies() || keepsArrows(event.target)) return;
    event.preventDefault();
    event.stopPropagation();
    this.keys.add(event.code);
    this.device = "keys";
  }

  readTouch(event, begins) {
    event.preventDefault();
    if (begins) this.pad.setPointerCapture(event.pointerId);
    const box = this.pad.getBoundingClientRect();
    const reach = 0.42 * Math.min(box.width, box.height);
    const right = (event.clientX - box.left - box.width / 2) / reach;
    const up = (box.top + box.height / 2 - event.clientY) / reach;
    this.touch = { forward: leaveDeadZone(limit(up), TOUCH_DEAD_ZONE), turn: leaveDeadZone(limit(right), TOUCH_DEAD_ZONE) };
    this.device = "touch";
  }

  leaveTouch() {
    if (this.touch) this.touch = { forward: 0, turn: 0 };
  }

  /** True if the active input device is still connected. */
  get present() {
    return this.device !== "gamepad" || this.gamepad !== null;
  }

  readGamepad() {
    const pads = navigator.getGamepads ? [...navigator.getGamepads()].filter((pad) => pad && pad.connected !== false) : [];
    const pad = pads.find((one) => one.mapping === "standard") ?? pads[0] ?? null;
    this.gamepad = pad;
    if (!pad) {
      this.held.clear();
      return null;
    }
    pad.buttons.forEach((button, k) => {
      if (button.pressed && !this.held.has(k) && k in BUTTONS) this.press(BUTTONS[k]);
      if (button.pressed) this.held.add(k);
      else this.held.delete(k);
    });
    const axes = { forward: leaveDeadZone(-pad.axes[1], DEAD_ZONE), turn: leaveDeadZone(pad.axes[0], DEAD_ZONE) };
    if (axes.forward || axes.turn) this.device = "gamepad";
    return axes;
  }

  /** Returns the stick's position {forward, turn}, each from -1 to 1. `seconds`: time since the last call. */
  read(seconds) {
    const pad = this.readGamepad();
    if (this.device === "gamepad") this.axes = pad ?? { forward: 0, turn: 0 };
    else if (this.device === "touch") this.axes = this.touch ?? { forward: 0, turn: 0 };
    else {
      const goal = { forward: 0, turn: 0 };
      for (const key of this.keys) goal[KEYS[key][0]] += KEYS[key][1];
      for (const axis of ["forward", "turn"]) this.axes[axis] = ramp(this.axes[axis], limit(goal[axis]), seconds);
    }
    return this.axes;
  }
}
