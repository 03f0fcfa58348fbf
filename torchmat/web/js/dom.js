// Elements of a page by their tag, attributes and children.

const MOMENT = 120; // milliseconds in which the picture of a change is sent off

/**
 * @param {string} tag such as "div", or "input"
 * @param {Record<string, any>} [attributes] `on...` are listeners, `class` and others attributes; null ones are left out
 * @param {...(Node|string|null)} children
 * @returns {HTMLElement}
 */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.filter((child) => child !== null));
  return made;
}

let count = 0;

/** @returns {string} an id that no other element has */
export function freshId() {
  count += 1;
  return `tmv-${count}`;
}

/**
 * Put off what only those notice who see an element: until it is in sight, and until a moment after it was asked for, so that the
 * picture itself comes first.
 * @param {HTMLElement} made
 * @param {() => void} act
 * @returns {() => void} asks for it; what was asked for several times happens once
 */
export function whenSeen(made, act) {
  let [due, seen, timer] = [false, false, 0];
  const later = () => {
    clearTimeout(timer);
    timer = setTimeout(() => {
      if (!due || !seen) return;
      due = false;
      act();
    }, MOMENT);
  };
  new IntersectionObserver((news) => {
    seen = news.at(-1).isIntersecting;
    if (due) later();
  }).observe(made);
  return () => {
    due = true;
    later();
  };
}

/**
 * A field with its label.
 * @param {string} label
 * @param {HTMLElement} field
 * @returns {HTMLElement}
 */
export function labelled(label, field) {
  field.id ||= freshId();
  return element("div", { class: "tmv-row" }, element("label", { for: field.id }, label), field);
}

/**
 * A choice of one.
 * @param {string[][]} options value and what it is called
 * @param {string} chosen
 * @param {(value: string) => void} changed
 * @returns {HTMLSelectElement}
 */
export function choice(options, chosen, changed) {
  const made = element("select", { onchange: (event) => changed(event.target.value) });
  for (const [value, title] of options) made.append(element("option", { value, selected: value === chosen }, title));
  return made;
}

/**
 * A slider with a typed number, both always showing the same value.
 * @param {{label: string, low: number, high: number, step: number, unit?: string, value: number, changed: (value: number) => void,
 *   extra?: HTMLElement}} given
 * @returns {{row: HTMLElement, set: (value: number) => void}}
 */
export function slider({ label, low, high, step, unit = "", value, changed, extra = null }) {
  const id = freshId();
  const range = element("input", { type: "range", id, min: low, max: high, step });
  const typed = element("input", { type: "number", min: low, max: high, step: "any", "aria-label": `${label}${unit ? `, ${unit}` : ""}` });
  const decimals = step < 0.01 ? 3 : step < 1 ? 2 : 1;
  let current = null;
  const set = (next) => {
    if (next === current) return;
    current = next;
    const shown = String(Number(next.toFixed(decimals)));
    range.value = next;
    if (document.activeElement !== typed) typed.value = shown;
    range.setAttribute("aria-valuetext", `${shown} ${unit}`.trim());
  };
  range.addEventListener("input", () => changed(Number(range.value)));
  typed.addEventListener("input", () => {
    const next = typed.valueAsNumber;
    if (Number.isFinite(next) && next >= low && next <= high) changed(next);
  });
  typed.addEventListener("blur", () => {
    const shown = current;
    current = null;
    set(shown);
  });
  set(value);
  const row = element("div", { class: "tmv-row tmv-slider" }, element("label", { for: id }, label), range, typed, extra);
  return { row, set };
}
