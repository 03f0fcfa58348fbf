// The graphics context of a canvas.

/** Thrown where a browser has no WebGL 2. */
export class NoWebGL2 extends Error {
  constructor() {
    super("This browser has no WebGL 2");
    this.name = "NoWebGL2";
  }
}

/**
 * @param {HTMLCanvasElement} canvas
 * @returns {{gl: WebGL2RenderingContext, caps: object}} throws NoWebGL2
 */
export function openContext(canvas) {
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "low-power" });
  if (!gl) throw new NoWebGL2();
  return { gl, caps: {} };
}
