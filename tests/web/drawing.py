"""A page that shades materials, and how far what it gives is from what Python gives."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import torch
from tests.web.browser import Chromium
from torch import Tensor

from torchmat.models import Material
from torchmat.web.payload import Payload, describe

_SCRIPT = """
async ({half}) => {
  const [{openContext}, {Material}, {evaluate}] = await Promise.all(["gl", "material", "evaluate"].map((name) => import(`/web/js/${name}.js`)));
  const context = openContext(document.createElement("canvas"), {half});
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  const text = (values) => {
    const all = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
    let found = "";
    for (let start = 0; start < all.length; start += 32768) found += String.fromCharCode(...all.subarray(start, start + 32768));
    return btoa(found);
  };
  const joined = (parts) => {
    const found = new Float32Array(parts.reduce((sum, part) => sum + part.length, 0));
    let start = 0;
    for (const part of parts) { found.set(part, start); start += part.length; }
    return text(found);
  };
  window.drawing = {
    context, bytes, text, joined, Material, evaluate,
    load(description, buffers) {
      this.material?.dispose();
      this.material = new Material(context, description, Object.fromEntries(Object.entries(buffers).map(([name, codes]) => [name, bytes(codes)])));
    },
    evaluateAll(pairs) { return joined(pairs.map(([light, view]) => evaluate(context, this.material, light, view))); },
    points(size, places) {
      const source = `uniform highp sampler2DArray places; out vec4 seen;
        vec4 place(int layer) { return texelFetch(places, ivec3(gl_FragCoord.xy, layer), 0); }
        void main() { vec4 uv = place(0); seen = vec4(shade(uv.xy, uv.z, place(1).xyz, place(2).xyz), cover(uv.xy, uv.z)); }`;
      const {gl} = context, input = gl.createTexture(), target = context.texture(...size, 4);
      gl.bindTexture(gl.TEXTURE_2D_ARRAY, input);
      gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.RGBA32F, ...size, 3, 0, gl.RGBA, gl.FLOAT, new Float32Array(bytes(places)));
      context.pass(`${this.material.glsl}\n${source}`, [target], size, (made) => {
        context.sample(made, "places", input, this.material.bind(made));
      });
      const found = context.read(target, size);
      gl.deleteTexture(input); gl.deleteTexture(target);
      return text(found);
    },
  };
}
"""


class Drawing:
    """A page with one context; `half` as on phones without targets of 32 bits."""

    def __init__(self, chromium: Chromium, half: bool = False) -> None:
        self.page = chromium.open_package()
        self.page.evaluate(_SCRIPT, {"half": half})

    def load(self, material: Material | Payload) -> None:
        """Give the page a material."""
        payload = describe(material) if isinstance(material, Material) else material
        buffers = {name: base64.b64encode(codes).decode() for name, codes in payload.buffers.items()}
        self.page.evaluate("([description, buffers]) => drawing.load(description, buffers)", [payload.description, buffers])

    def evaluate(self, light: Tensor, view: Tensor, size: tuple[int, int]) -> Tensor:
        """Return what `evaluate.js` gives under lights and views [n, 3, 1, 1], as [n, 3, H, W]."""
        pairs = torch.stack((light[..., 0, 0], view[..., 0, 0]), dim=1).tolist()
        found = floats(self.page.evaluate("(pairs) => drawing.evaluateAll(pairs)", pairs))
        return found.reshape(len(pairs), *size, 4)[..., :3].movedim(-1, 1)

    def points(self, uv: Tensor, level: Tensor, light: Tensor, view: Tensor) -> Tensor:
        """Return `shade` and `cover`, [4, h, w], at uv [2, h, w] and level [h, w] for directions [3, h, w]."""
        height, width = level.shape
        nothing = torch.zeros(1, height, width)
        layers = torch.stack((torch.cat((uv, level[None], nothing)), torch.cat((light, nothing)), torch.cat((view, nothing))))
        codes = base64.b64encode(layers.float().movedim(1, -1).contiguous().numpy().tobytes()).decode()
        found = self.page.evaluate("([size, places]) => drawing.points(size, places)", [[width, height], codes])
        return floats(found).reshape(height, width, 4).movedim(-1, 0)

    def close(self) -> list[str]:
        """Close the page and return its problems."""
        problems = self.page.problems
        self.page.close()
        return problems


def floats(text: Any) -> Tensor:
    """Return the numbers of a text in base64, as float64."""
    return torch.from_numpy(np.frombuffer(base64.b64decode(text), dtype="<f4").astype(np.float64))


def relative_error(found: Tensor, expected: Tensor) -> float:
    """Return the sum of squared differences over that of squares, as a report has it; 0 where both are 0."""
    expected = expected.double()
    return float((found - expected).square().sum() / expected.square().sum().clamp(min=1e-30))
