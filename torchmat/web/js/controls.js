// What hands do to the picture: drag, wheel, fingers, keys.

const PER_PIXEL = 0.4; // degrees
const STEP = 5;
const FINE = 1;

/** What the keys do, for the page to say. */
export const HELP = [
  ["Drag, arrow keys", "turn the object"],
  ["Shift + drag, Shift + arrow keys", "move the light"],
  ["Alt + arrow keys", "the same by one degree"],
  ["Wheel, + and −", "come nearer, go away"],
  ["Shift + wheel, Shift with + and −", "the distance of a point light"],
  ["One finger", "turn the object"],
  ["Two fingers", "apart or together: distance; side by side: move the light"],
  ["Page up, page down", "brighter, darker"],
  ["O", "the next object"],
  ["L", "the next light"],
  ["P", "run or stop the sweeps"],
  ["0 or Home", "start again"],
];

/**
 * Let hands act on a viewer by its canvas.
 * @param {HTMLCanvasElement} canvas
 * @param {object} viewer of viewer.js
 * @returns {() => void} takes the listeners away
 */
export function attachControls(canvas, viewer) {
  const over = new AbortController();
  const on = (name, act, options = {}) => canvas.addEventListener(name, act, { ...options, signal: over.signal });
  const pointers = new Map();

  on("pointerdown", (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture?.(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.classList.add("tmv-held");
    viewer.touched();
  });
  on("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    if (pointers.size === 2) twoFingers(viewer, pointers, event.pointerId, now);
    else if (pointers.size === 1) dragged(viewer, now[0] - before[0], now[1] - before[1], event.shiftKey || event.buttons === 2);
    pointers.set(event.pointerId, now);
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    on(name, (event) => {
      pointers.delete(event.pointerId);
      if (!pointers.size) canvas.classList.remove("tmv-held");
    });
  }
  on("contextmenu", (event) => event.preventDefault());
  on("wheel", (event) => {
    // Within a longer page the wheel scrolls that until the picture was chosen.
    if (viewer.embedded && document.activeElement !== canvas) return;
    event.preventDefault();
    const delta = event.deltaY || event.deltaX;
    const steps = event.deltaMode === 1 ? delta / 3 : delta / 100;
    viewer.touched();
    if (event.shiftKey || event.altKey) viewer.moveLight(0, 0, 1.1 ** steps);
    else viewer.zoom(1.1 ** -steps);
  }, { passive: false });
  on("keydown", (event) => {
    if (event.ctrlKey || event.metaKey) return;
    if (!pressed(viewer, event)) return;
    event.preventDefault();
    viewer.touched();
    viewer.say();
  });
  return () => over.abort();
}

function dragged(viewer, right, down, light) {
  if (light) viewer.moveLight(right * PER_PIXEL, -down * PER_PIXEL);
  // The object follows the hand: the camera goes the other way.
  else viewer.turn(-right * PER_PIXEL, down * PER_PIXEL);
}

function twoFingers(viewer, pointers, moved, now) {
  const [[, other]] = [...pointers].filter(([id]) => id !== moved);
  const before = pointers.get(moved);
  const apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]);
  if (apart(before) > 10) viewer.zoom(apart(now) / apart(before));
  // The middle between two fingers moves by half of what one does.
  viewer.moveLight((now[0] - before[0]) / 2 * PER_PIXEL, -(now[1] - before[1]) / 2 * PER_PIXEL);
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

function pressed(viewer, event) {
  const arrow = ARROWS[event.key];
  if (arrow) {
    const step = event.altKey ? FINE : STEP;
    if (event.shiftKey) viewer.moveLight(arrow[0] * step, arrow[1] * step);
    else viewer.turn(-arrow[0] * step, -arrow[1] * step);
    return true;
  }
  const nearer = { "+": 1, "=": 1, "*": 1, "-": -1, "_": -1 }[event.key];
  if (nearer) {
    if (event.shiftKey && event.key !== "=") viewer.moveLight(0, 0, 1.1 ** -nearer);
    else viewer.zoom(1.1 ** nearer);
    return true;
  }
  const act = {
    PageUp: () => viewer.expose(0.25), PageDown: () => viewer.expose(-0.25), o: () => viewer.nextMesh(), l: () => viewer.nextLight(),
    p: () => viewer.toggleSweeps(), 0: () => viewer.reset(), Home: () => viewer.reset(),
  }[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  act?.();
  return Boolean(act);
}
