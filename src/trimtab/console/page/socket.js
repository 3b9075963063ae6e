// WebSocket to the server: it reconnects, dispatches messages, and sends requests and waits for their answers.

import { useSocket } from "./stop.js";

const FIRST_WAIT = 0.25;
const LONGEST_WAIT = 5;
const WAIT_GROWTH = 1.7;
const OPENING_LIMIT = 4;
const SILENCE_LIMIT = 3;
const PING_PERIOD = 0.5;
const ANSWER_LIMIT = 4;
const PINGS_KEPT = 30;

/** Returns the time (s) of the page's own clock. */
export function readClock() {
  return performance.now() / 1000;
}

/** Offset of the server's clock from the page's clock, estimated from the ping with the shortest round trip. */
class ClockOffset {
  constructor() {
    this.clear();
  }

  clear() {
    this.pings = [];
    this.offset = NaN;
    this.round_trip = NaN;
  }

  add(sent, clock, received) {
    this.pings.push({ round_trip: received - sent, offset: clock - (sent + received) / 2 });
    if (this.pings.length > PINGS_KEPT) this.pings.shift();
    const best = this.pings.reduce((a, b) => (b.round_trip < a.round_trip ? b : a));
    this.offset = best.offset;
    this.round_trip = best.round_trip;
  }
}

export class Connection {
  constructor(url) {
    this.url = url;
    this.listeners = new Map();
    this.waiting = new Map();
    this.clock = new ClockOffset();
    this.socket = null;
    this.connected = false;
    this.wait = FIRST_WAIT;
    this.retry_at = 0;
    this.heard = -Infinity;
    this.next_id = 1;
    this.over = false;
    setInterval(() => this.watch(), 1000 * PING_PERIOD);
  }

  /** Registers a function for messages of a type, for binary messages ("row"), or for "open" and "lost". */
  on(type, listener) {
    if (!this.listeners.has(type)) this.listeners.set(type, []);
    this.listeners.get(type).push(listener);
  }

  tell(type, message) {
    for (const listener of this.listeners.get(type) ?? []) {
      try {
        listener(message);
      } catch (error) {
        console.error(type, error);
      }
    }
  }

  open() {
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.opened_at = readClock();
    useSocket(socket);
    socket.addEventListener("open", () => this.noteOpen(socket));
    socket.addEventListener("message", (event) => this.read(socket, event.data));
    socket.addEventListener("close", () => this.noteLost(socket));
  }

  noteOpen(socket) {
    if (socket !== this.socket) return;
    this.connected = true;
    this.heard = readClock();
    this.clock.clear();
    this.tell("open", null);
    this.send({ type: "ping", sent: readClock() });
  }

  noteLost(socket) {
    if (socket !== this.socket) return;
    this.socket = null;
    this.connected = false;
    for (const { resolve } of this.waiting.values()) resolve({ ok: false, text: "the connection was lost" });
    this.waiting.clear();
    this.retry_at = readClock() + this.wait;
    setTimeout(() => this.open(), 1000 * this.wait);
    this.wait = Math.min(LONGEST_WAIT, this.wait * WAIT_GROWTH);
    this.tell("lost", null);
  }

  read(socket, data) {
    if (socket !== this.socket) return;
    this.heard = readClock();
    if (data instanceof ArrayBuffer) {
      this.tell("row", data);
      return;
    }
    const message = JSON.parse(data);
    if (message.type === "hello") this.wait = FIRST_WAIT;
    if (message.type === "pong") this.clock.add(message.sent, message.clock, this.heard);
    if (message.type === "answer") this.settle(message);
    this.tell(message.type, message);
  }

  settle(answer) {
    const asked = this.waiting.get(answer.id);
    if (!asked) return;
    this.waiting.delete(answer.id);
    clearTimeout(asked.timer);
    asked.resolve({ ok: answer.ok, text: answer.text ?? "" });
  }

  /** Sends a ping, or closes the socket if the server no longer answers. */
  watch() {
    if (!this.socket) return;
    const quiet = readClock() - (this.connected ? this.heard : this.opened_at);
    if (quiet > (this.connected ? SILENCE_LIMIT : OPENING_LIMIT)) {
      const socket = this.socket;
      socket.close();
      this.noteLost(socket);
    } else this.send({ type: "ping", sent: readClock() });
  }

  /** Sends a message at once. Returns false if there is no connection. */
  send(message) {
    if (!this.connected || this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Sends a message with an id, and returns a promise of its answer {ok, text}. */
  ask(message) {
    const id = this.next_id++;
    return new Promise((resolve) => {
      if (!this.send({ ...message, id })) {
        resolve({ ok: false, text: "no connection: not sent" });
        return;
      }
      const timer = setTimeout(() => {
        this.waiting.delete(id);
        resolve({ ok: false, text: `no answer in ${ANSWER_LIMIT} s` });
      }, 1000 * ANSWER_LIMIT);
      this.waiting.set(id, { resolve, timer });
    });
  }
}
