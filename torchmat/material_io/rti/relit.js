// What pages of relightable images share: the weights of a light, and the shader that sums the planes with them.

// The functions of the light that the coefficients weigh, in the order of the planes.
function weights(info, x, y) {
  const terms = info.colorspace === "lrgb" ? info.nplanes - 3 : info.nplanes / 3;
  const z = Math.sqrt(Math.max(0, 1 - x * x - y * y));
  if (info.type === "ptm") return [1, x, y, x * x, x * y, y * y].slice(0, terms);
  const p = Math.PI, azimuth = Math.atan2(y, x), root = Math.sqrt(z - z * z), c = Math.cos, s = Math.sin;
  return [
    1 / Math.sqrt(2 * p),
    Math.sqrt(6 / p) * c(azimuth) * root,
    Math.sqrt(3 / (2 * p)) * (2 * z - 1),
    Math.sqrt(6 / p) * s(azimuth) * root,
    Math.sqrt(30 / p) * c(2 * azimuth) * (z * z - z),
    Math.sqrt(30 / p) * c(azimuth) * (2 * z - 1) * root,
    Math.sqrt(5 / (2 * p)) * (1 - 6 * z + 6 * z * z),
    Math.sqrt(30 / p) * s(azimuth) * (2 * z - 1) * root,
    Math.sqrt(30 / p) * s(2 * azimuth) * (z * z - z),
  ].slice(0, terms);
}

// A place on the picture as a light: right and up from its middle, at most as far as the horizon.
function lightAt(x, y) {
  const far = Math.max(1, Math.hypot(x, y) / 0.995);
  return [x / far, y / far];
}

function fragment(info) {
  const count = Math.ceil(info.nplanes / 3), lrgb = info.colorspace === "lrgb", terms = lrgb ? info.nplanes - 3 : count;
  let code = `#version 300 es
precision highp float;
in vec2 place;
out vec4 shown;
uniform vec3 scale[${count}], bias[${count}];
uniform float weight[${terms}];
`;
  for (let k = 0; k < count; k++) code += `uniform sampler2D plane${k};\n`;
  const value = k => `(texture(plane${k}, place).rgb - bias[${k}]) * scale[${k}]`;
  code += "void main() {\n  vec3 total = vec3(0.0);\n";
  for (let k = lrgb ? 1 : 0; k < count; k++) {
    const j = 3 * (k - 1);
    code += lrgb
      ? `  total += dot(${value(k)}, vec3(weight[${j}], weight[${j + 1}], weight[${j + 2}]));\n`
      : `  total += weight[${k}] * ${value(k)};\n`;
  }
  return code + (lrgb ? `  total *= ${value(0)};\n` : "") + "  shown = vec4(clamp(total, 0.0, 1.0), 1.0);\n}\n";
}

function made(gl, kind, source) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  return shader;
}

async function loaded(source) {
  const image = new Image();
  image.src = source;
  await image.decode();
  return image;
}

function linked(gl, vertex, fragment) {
  const program = gl.createProgram();
  gl.attachShader(program, made(gl, gl.VERTEX_SHADER, vertex));
  gl.attachShader(program, made(gl, gl.FRAGMENT_SHADER, fragment));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  gl.useProgram(program);
  return program;
}

// The textures of images, of which the codes are taken as they are: coefficients are no colours.
function textured(gl, images, filter) {
  gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
  gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
  return images.map((image) => {
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image);
    for (const name of ["MIN", "MAG"]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}_FILTER`], filter);
    for (const name of ["S", "T"]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_WRAP_${name}`], gl.CLAMP_TO_EDGE);
    return texture;
  });
}

// Says which textures the planes are, and by what ranges their codes are values; returns where the weights go.
function prepared(gl, program, info) {
  for (let k = 0; k < Math.ceil(info.nplanes / 3); k++) gl.uniform1i(gl.getUniformLocation(program, `plane${k}`), k);
  gl.uniform3fv(gl.getUniformLocation(program, "scale"), info.materials[0].scale);
  gl.uniform3fv(gl.getUniformLocation(program, "bias"), info.materials[0].bias);
  return gl.getUniformLocation(program, "weight");
}

function bound(gl, textures) {
  textures.forEach((texture, k) => {
    gl.activeTexture(gl.TEXTURE0 + k);
    gl.bindTexture(gl.TEXTURE_2D, texture);
  });
}
