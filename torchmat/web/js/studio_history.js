// What was saved, by whom so ever, and the way back; and what is wrong with a file at the moment.

import { element } from "./dom.js";

const SHOWN = 12;

/** @param {import("./studio_live.js").Live} live @returns {HTMLElement} */
export function historyPanel(live) {
  const says = element("ul", { class: "tms-says", role: "status", "aria-label": "What is wrong" });
  const lines = new Map();
  const say = ({ about, level, text }) => {
    lines.get(about)?.remove();
    lines.delete(about);
    if (!text) return;
    const line = element("li", { class: `tms-${level}` }, text);
    lines.set(about, line);
    says.append(line);
  };
  const failed = (error) => say({ about: "wish", level: "error", text: error.message });
  const ask = (type, keywords) => {
    say({ about: "wish", text: "" });
    live.wish(type, keywords).catch(failed);
  };
  const undo = element("button", { type: "button", onclick: () => ask("undo") }, "Undo");
  const redo = element("button", { type: "button", onclick: () => ask("redo") }, "Redo");
  const list = element("ol", { class: "tms-states" });

  live.on("hello", (hello) => {
    says.replaceChildren();
    lines.clear();
    hello.says.forEach(say);
    show(hello.history);
  });
  live.on("says", say);
  live.on("history", show);
  live.on("problem", failed);
  live.on("lost", () => say({ about: "connection", level: "error", text: "The studio does not answer. The page shows what it last showed." }));

  function show({ states, at }) {
    undo.disabled = at <= 0;
    redo.disabled = at >= states.length - 1;
    const first = Math.max(0, Math.min(at - SHOWN / 2, states.length - SHOWN));
    list.replaceChildren(...states.slice(first, first + SHOWN).map(({ when, what }, place) => {
      const state = first + place;
      const time = new Date(1000 * when).toLocaleTimeString();
      const button = element("button", { type: "button", "aria-pressed": String(state === at), onclick: () => ask("back", { state }) }, what);
      return element("li", {}, button, element("small", {}, time));
    }).reverse());
  }

  const keys = (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || event.target.closest?.("input[type=number]")) return;
    event.preventDefault();
    ask(event.shiftKey ? "redo" : "undo");
  };
  document.addEventListener("keydown", keys);
  return element("div", {}, says, element("div", { class: "tmv-buttons" }, undo, redo), list);
}
