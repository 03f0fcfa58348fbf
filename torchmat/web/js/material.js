// A matte stand-in for materials, whatever they are.

/** A material on the graphics processor. */
export class Material {
  constructor(context, description) {
    Object.assign(this, { gl: context.gl, description });
  }

  get size() {
    return this.description.size;
  }

  get glsl() {
    return `vec3 shade(vec2 uv, float level, vec3 light, vec3 view) {
  vec2 cell = floor(fract(uv) * 8.0);
  return mix(vec3(0.2, 0.3, 0.5), vec3(0.8, 0.7, 0.5), mod(cell.x + cell.y, 2.0)) * light.z;
}
float cover(vec2 uv, float level) { return 1.0; }
`;
  }

  bind(program, firstUnit) {
    return firstUnit;
  }

  update() {}

  dispose() {}
}
