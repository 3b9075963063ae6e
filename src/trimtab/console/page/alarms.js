// Display of alarms: a banner at a fixed place, the title of the browser tab, and the list of events.

import { build, formatFixed, write } from "./format.js";

const MOST_EVENTS = 300;
const SIGNS = { alarm: "⬣", warning: "▲", none: "✓", info: "•" };
const LEVELS = ["alarm", "warning"];
const IN_BANNER = 2;

/** Order of alarms: alarm before warning, unacknowledged before acknowledged, old before new. */
function compareAlarms(a, b) {
  return LEVELS.indexOf(a.level) - LEVELS.indexOf(b.level) || Number(a.acknowledged) - Number(b.acknowledged) || a.since - b.since;
}

function describe(alarm) {
  return `${alarm.level === "alarm" ? "Alarm" : "Warning"}: ${alarm.text}${alarm.acknowledged ? " (acknowledged)" : ""}`;
}

export class AlarmBanner {
  constructor(connection) {
    this.connection = connection;
    this.alarms = [];
    this.told = [];
    this.own = null;
    this.goTo = null;
    this.known = new Set();
    this.banner = document.getElementById("banner");
    this.sign = document.getElementById("banner-sign");
    this.text = document.getElementById("banner-text");
    this.more = document.getElementById("banner-more");
    this.button = document.getElementById("banner-acknowledge");
    this.list = document.getElementById("alarms");
    this.events = document.getElementById("events");
    this.title = document.title;
    this.button.addEventListener("click", () => this.acknowledge());
    this.list.addEventListener("click", (event) => {
      const id = event.target.closest("button")?.dataset.alarm;
      if (id) this.connection.send({ type: "acknowledge", alarm: id });
    });
  }

  /** Acknowledges the first unacknowledged alarm. The alarm stays as long as its cause. */
  acknowledge() {
    const first = this.alarms.find((alarm) => !alarm.acknowledged && alarm.id !== null);
    if (first) this.connection.send({ type: "acknowledge", alarm: first.id });
  }

  showStatus(status) {
    this.told = status.alarms ?? [];
    this.show();
  }

  /** Shows an alarm that the page itself raises for missing data. An empty text removes the alarm. */
  showOwn(text) {
    if ((this.own?.text ?? "") === text) return;
    this.own = text ? { id: null, level: "alarm", text, since: -Infinity, acknowledged: false } : null;
    this.show();
  }

  show() {
    this.alarms = [...this.told].sort(compareAlarms);
    if (this.own) this.alarms.unshift(this.own);
    const first = this.alarms[0];
    const level = first?.level ?? "none";
    this.banner.dataset.level = level;
    this.banner.classList.toggle("seen", this.alarms.every((alarm) => alarm.acknowledged));
    write(this.sign, SIGNS[level]);
    write(this.text, first ? this.alarms.slice(0, IN_BANNER).map(describe).join(" · ") : "No alarms");
    const more = this.alarms.length - IN_BANNER;
    write(this.more, more > 0 ? `and ${more} more` : "");
    this.button.hidden = !this.alarms.some((alarm) => !alarm.acknowledged && alarm.id !== null);
    const title = first ? `${SIGNS[level]} ${first.text} – trimtab` : `${document.getElementById("scenario").textContent} – trimtab`;
    if (document.title !== title) document.title = title;
    this.showList();
  }

  showList() {
    const key = JSON.stringify(this.told);
    if (key === this.shown) return;
    this.shown = key;
    this.list.replaceChildren(
      ...this.told.map((alarm) => {
        const item = build("li", { class: `level-${alarm.level}` }, build("i", { text: SIGNS[alarm.level] }), build("span", { text: alarm.text }));
        item.append(build("time", { text: `since ${formatFixed(alarm.since, 1)} s` }));
        item.append(alarm.acknowledged ? build("small", { text: "acknowledged" }) : build("button", { type: "button", text: "Acknowledge", "data-alarm": alarm.id }));
        return item;
      }),
    );
  }

  /** Adds an event on top of the list, unless it is listed: after a reconnection the server sends all events again. */
  addEvent({ t, text, level }) {
    const key = `${t} ${text}`;
    if (this.known.has(key)) return;
    this.known.add(key);
    const item = build("li", { class: `level-${level}` }, build("i", { text: SIGNS[level] ?? SIGNS.info }), build("time", { text: formatFixed(t, 2) }), build("span", { text }));
    if (this.goTo) {
      const button = build("button", { type: "button", class: "event" }, ...item.childNodes);
      button.addEventListener("click", () => this.goTo(t));
      item.append(button);
    }
    this.events.prepend(item);
    while (this.events.children.length > MOST_EVENTS) this.events.lastChild.remove();
  }

  clearEvents() {
    this.known.clear();
    this.events.replaceChildren();
  }
}
