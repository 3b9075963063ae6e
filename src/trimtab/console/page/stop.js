// Stops the flight, by the button or the space bar. This file imports nothing and is loaded first, so that it works
// even if other parts of the page fail.

const REPEAT_MS = 100;
const SHOW_STOPPED_MS = 3000;
const SAFE_MODES = ["ended", "fault"];
const TYPED_IN = ["text", "search", "url", "email", "password", "tel"];

export const stopping = { wanted: false, sent: 0, safe: false };
const link = { socket: null, watches: false, flies: true };
const button = document.getElementById("stop");
const name = document.getElementById("stop-name");
const text = document.getElementById("stop-text");

/** Returns true if the key press goes to a text field, in which the space bar types a space. */
function isTyping(target) {
  if (target instanceof HTMLTextAreaElement || target?.isContentEditable) return true;
  return target instanceof HTMLInputElement && TYPED_IN.includes(target.type);
}

function show() {
  button.classList.toggle("stopping", stopping.wanted);
  name.textContent = stopping.wanted ? (stopping.safe ? "STOPPED" : "STOPPING") : "STOP";
  if (link.watches) text.textContent = "observers cannot stop";
  else if (!stopping.wanted) text.textContent = "space bar";
  else if (stopping.safe) text.textContent = "the flight has stopped";
  else if (stopping.sent === 0) text.textContent = "no connection: not sent yet";
  else text.textContent = `sent ${stopping.sent} times`;
}

function sendOnce() {
  if (!stopping.wanted || link.watches) return;
  const open = link.socket && link.socket.readyState === WebSocket.OPEN;
  if (open && !stopping.safe) {
    link.socket.send('{"type": "stop"}');
    stopping.sent += 1;
  }
  show();
}

/** Requests a stop. The request is repeated until the flight has stopped. */
export function stopFlight() {
  if (link.watches || !link.flies) return;
  if (!stopping.wanted || stopping.safe) Object.assign(stopping, { wanted: true, sent: 0, safe: false });
  sendOnce();
}

function noteSafe() {
  if (!stopping.wanted || stopping.safe || stopping.sent === 0) return;
  stopping.safe = true;
  show();
  setTimeout(() => {
    if (stopping.safe) stopping.wanted = false;
    show();
  }, SHOW_STOPPED_MS);
}

/** Takes the supervisor's mode from the newest row, and ends the request if the flight has stopped. */
export function noteMode(mode) {
  if (SAFE_MODES.includes(mode)) noteSafe();
}

function readMessage(event) {
  if (typeof event.data !== "string") return;
  const message = JSON.parse(event.data);
  if (message.type === "hello") {
    link.watches = message.role === "observer";
    link.flies = message.kind === "flight";
    button.hidden = !link.flies;
    button.disabled = link.watches;
    show();
  }
  if (message.type === "end" || (message.type === "status" && message.armed === false)) noteSafe();
}

/** Uses this socket for all further messages. */
export function useSocket(socket) {
  link.socket = socket;
  socket.addEventListener("message", readMessage);
  socket.addEventListener("open", sendOnce);
}

function readKey(event) {
  if (event.code !== "Space" || !link.flies || isTyping(event.target)) return;
  event.preventDefault();
  event.stopImmediatePropagation();
  if (event.type === "keydown" && !event.repeat) stopFlight();
}

function leaveText(event) {
  if (event.code === "Escape" && isTyping(event.target)) event.target.blur();
}

window.addEventListener("keydown", readKey, { capture: true });
window.addEventListener("keyup", readKey, { capture: true });
window.addEventListener("keydown", leaveText, { capture: true });
button.addEventListener("pointerdown", stopFlight);
button.addEventListener("click", (event) => event.detail === 0 && stopFlight());
setInterval(sendOnce, REPEAT_MS);
