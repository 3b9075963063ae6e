// Tabs beside the plots, and the choice of day or night colours.

const THEMES = ["day", "night"];

/** Shows one panel at a time. The arrow keys move between the tabs. */
export function prepareTabs() {
  const tabs = [...document.querySelectorAll("#tabs [role=tab]")];
  const select = (chosen) => {
    for (const tab of tabs) {
      const is_chosen = tab === chosen;
      tab.setAttribute("aria-selected", String(is_chosen));
      tab.tabIndex = is_chosen ? 0 : -1;
      document.getElementById(tab.getAttribute("aria-controls")).hidden = !is_chosen;
    }
  };
  tabs.forEach((tab, k) => {
    tab.addEventListener("click", () => select(tab));
    tab.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.code];
      if (!step) return;
      event.stopPropagation();
      const next = tabs[(k + step + tabs.length) % tabs.length];
      select(next);
      next.focus();
    });
  });
  select(tabs[0]);
}

function readKept() {
  try {
    return localStorage.getItem("trimtab theme");
  } catch {
    return null;
  }
}

/** Follows the system's light or dark setting until the button is pressed. Calls back after each change. */
export function prepareTheme(changed) {
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const root = document.documentElement;
  const apply = (theme) => {
    root.dataset.theme = theme;
    changed();
  };
  const system = () => (dark.matches ? "night" : "day");
  const kept = readKept();
  root.dataset.theme = THEMES.includes(kept) ? kept : system();
  dark.addEventListener("change", () => readKept() ?? apply(system()));
  document.getElementById("theme").addEventListener("click", () => {
    const theme = root.dataset.theme === "day" ? "night" : "day";
    apply(theme);
    localStorage.setItem("trimtab theme", theme);
  });
}
