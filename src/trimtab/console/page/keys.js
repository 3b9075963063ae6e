// Keyboard shortcuts, except the space bar and the keys of the stick, and the help that lists all keys.

import { build } from "./format.js";

const HELP = [
  ["Space", "STOP the flight, from anywhere but a text field; in a recording: play or pause"],
  ["Esc", "leave a text field, close a list"],
  ["T", "take or release the stick"],
  ["↑ ↓ ← → or W A S D", "fly: forward, back, turn, while you have the stick"],
  ["M", "next mode of the stick"],
  ["K", "acknowledge the alarm"],
  ["F", "follow the craft: on, off"],
  ["+ and −", "zoom"],
  [", and .", "recording: one step back or forward"],
  ["1 2 3 4", "checks, tune, health, events"],
  ["?", "this help"],
];
const GAMEPAD = [
  ["left stick", "forward and turn"],
  ["A, button 0", "take the stick"],
  ["B, button 1", "STOP"],
  ["Y, button 3", "next mode of the stick"],
];

/** Calls the action of a key, unless a text is being typed. */
export function listenToKeys(actions) {
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
    const { target } = event;
    if (target instanceof HTMLTextAreaElement || target instanceof HTMLSelectElement) return;
    if (target instanceof HTMLInputElement && target.type !== "range") return;
    const is_button = target instanceof HTMLButtonElement;
    const action = actions[event.code];
    if (action && !(is_button && event.code === "Space")) {
      action();
      event.preventDefault();
    }
    const tab = ["Digit1", "Digit2", "Digit3", "Digit4"].indexOf(event.code);
    if (tab >= 0) document.querySelectorAll("#tabs [role=tab]")[tab].click();
  });
}

function listKeys(rows) {
  return build("dl", {}, ...rows.flatMap(([keys, text]) => [build("dt", {}, build("kbd", { text: keys })), build("dd", { text })]));
}

export function prepareHelp() {
  const help = document.getElementById("help");
  const opener = document.getElementById("help-open");
  const close = build("button", { type: "button", text: "Close" });
  help.append(build("div", { class: "toolbar" }, build("h2", { text: "Keys" }), build("span", { class: "push" }), close));
  help.append(
    build("div", { class: "columns" }, listKeys(HELP), build("h2", { text: "Gamepad" }), listKeys(GAMEPAD)),
    build("p", { class: "small", text: "Angles are shown in degrees; parameters are set in the unit beside them, radians for angles. Plots: dotted lines are set-points, dashed lines the second flight." }),
  );
  const toggle = () => {
    if (help.open) {
      help.close();
      opener.focus();
    } else {
      help.show();
      close.focus();
    }
  };
  close.addEventListener("click", toggle);
  opener.addEventListener("click", toggle);
  window.addEventListener("keydown", (event) => {
    if (event.code === "Escape" && help.open) toggle();
    const typing = event.target instanceof HTMLInputElement && event.target.type !== "range";
    if (event.key === "?" && !typing) toggle();
  });
}
