// A material on the graphics card: its maps as textures, and the GLSL that reads and shades them.

import { decoded } from "./codes.js";
import { TexelMap, levelsOf } from "./maps.js";
import { Relief } from "./relief.js";

const FORMAT = "torchmat-web";
const VERSION = 1;
const HEADER = `precision highp float;
precision highp int;
precision highp sampler2DArray;`;

/** A material that shaders can read. */
export class Material {
  /**
   * Throws an Error for a description of another format, and for maps that are larger than the browser takes.
   * @param {import("./gl.js").Context} context
   * @param {object} description as torchmat/web/payload.py makes it
   * @param {Record<string, ArrayBuffer>} buffers the codes of each map, kept for a context that is lost
   */
  constructor(context, description, buffers) {
    if (description.format !== FORMAT || description.version !== VERSION) {
      throw new Error(`The material must be ${FORMAT} ${VERSION}; it is ${description.format} ${description.version}.`);
    }
    this.context = context;
    this.description = description;
    this.numbers = { ...description.numbers };
    this.entries = new Map(description.maps.map((entry) => [entry.name, entry]));
    this.buffers = { ...buffers };
    this.make();
    this.forget = context.onRestore(() => this.make());
  }

  make() {
    const { context, description } = this;
    this.maps = new Map();
    for (const [name, entry] of this.entries) {
      // What normals and finer heights are made of: shaders read what is made.
      const hidden = (name === "height" && description.relief === "fine") || (name === "normal" && description.derives_normal);
      const kept = hidden || (name === "height" && description.relief !== null);
      this.maps.set(name, new TexelMap(context, entry, this.buffers[name], description.size, description.tiles, { kept, hidden }));
    }
    this.relief = description.relief ? new Relief(context, description, this.maps) : null;
  }

  /** How many levels of half the size each there are, from level 0 on. */
  get levels() {
    return levelsOf(this.description.size);
  }

  /** Every texture by the name of its sampler. */
  get textures() {
    const own = [...this.maps].filter(([, { texture }]) => texture).map(([name, { texture }]) => [`map_${name}`, texture]);
    return new Map([...own, ...(this.relief?.textures ?? [])]);
  }

  /** Numbers by the name of their uniform. */
  get uniforms() {
    const found = Object.entries(this.numbers).map(([name, values]) => [`number_${name}`, values]);
    return this.relief ? [...found, ["number_height_range", this.relief.range]] : found;
  }

  /**
   * GLSL to put after `#version 300 es`: `vec3 shade(vec2 uv, float level, vec3 light, vec3 view)`, `float cover(vec2 uv, float level)`,
   * and what they are made of (torchmat/models/base.glsl).
   */
  get glsl() {
    const { description } = this;
    const [height, width] = description.size;
    const defines = { SIZE: `ivec2(${width}, ${height})`, LEVELS: this.levels, ...description.defines };
    return [
      HEADER,
      ...Object.entries(defines).map(([name, value]) => `#define ${name} ${value}`),
      ...[...this.textures.keys()].map((name) => `uniform highp sampler2DArray ${name};`),
      ...this.uniforms.map(([name, values]) => `uniform float ${name}[${values.length}];`),
      description.glsl,
    ].join("\n");
  }

  /**
   * Gives the program in use the maps and numbers.
   * @param {{at: (name: string) => WebGLUniformLocation | null}} made as `context.program` returns it
   * @param {number} firstUnit
   * @returns {number} the unit after the last that was taken
   */
  bind(made, firstUnit = 0) {
    const { context } = this;
    let unit = firstUnit;
    for (const [name, texture] of this.textures) {
      if (made.at(name) === null) continue;  // the compiler found that nobody reads it
      if (unit >= context.caps.units) throw new Error(`The material must fit this browser's ${context.caps.units} textures at once; it has more.`);
      context.sample(made, name, texture, unit++);
    }
    for (const [name, values] of this.uniforms) context.gl.uniform1fv(made.at(`${name}[0]`), values);
    return unit;
  }

  /**
   * Replaces one map by other codes of it, and what follows from it. Codes of another size are brought to the material's.
   * @param {string} name
   * @param {object} entry as in the description
   * @param {ArrayBuffer} buffer
   */
  update(name, entry, buffer) {
    const map = this.maps.get(name);
    if (!map) throw new Error(`The material has no map ${name}; it has ${[...this.maps.keys()].join(", ")}.`);
    // Codes that are not whole throw here, and leave all as it was.
    if (this.context.lost) decoded(entry, buffer);
    else map.fill(entry, buffer);
    this.entries.set(name, entry);
    this.buffers[name] = buffer;
    if (this.context.lost) return; // it is made anew from these
    if (this.relief?.follows(name)) this.relief.update();
  }

  /** Replaces numbers that the material has beside its maps, such as those of a lobe. */
  setNumbers(name, values) {
    if (this.numbers[name]?.length !== values.length) throw new Error(`The material has no ${values.length} numbers ${name}.`);
    this.numbers[name] = [...values];
  }

  dispose() {
    this.forget();
    this.relief?.dispose();
    for (const map of this.maps.values()) map.dispose();
  }
}
