"""One parametric lobe for the whole material plus a spatially varying residual function (Ma et al. 2004).

``f(P, V, L) = k_d (N.L) + k_s (N.H)^n + delta*(P, V, L)``. The residual families beyond the paper's ``s(P) . H`` and
the anisotropic lobe are the paper's own future work.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor

from torchmat.errors import check_option
from torchmat.fast import sums as fast_sums
from torchmat.models.base import Material, combine
from torchmat.models.bases import BASES
from torchmat.models.lobes import LOBES
from torchmat.models.storage import MapSpec

RESIDUALS = ("half", "half_light", "quadratic", "cosine")


class PhongSrf(Material):
    """Phong + residual: one lobe for all texels, and a few numbers of each (Ma et al. 2004).

    `residual` names the family: "half" (the paper's, 9 numbers a texel), "half_light" (21), "quadratic" (45) or "cosine"
    (3: a colour times the light's cosine, a texture under the lobe);
    `base` the lobe: "phong" or "ashikhmin_shirley". Maps: `lobe` (constants), `residual` [3 K, H, W], an RGB texture
    per term. The sum is clamped at 0, which the paper does not say and a picture needs.
    """

    name = "phong_srf"
    glsl = "phong_srf.glsl"

    def __init__(
        self, maps: Mapping[str, Tensor], *, residual: str = "half", base: str = "phong", **settings: Any
    ) -> None:
        check_option(self.name, "residual", residual, RESIDUALS)
        check_option(self.name, "base", base, LOBES)
        self._basis, self._lobe = BASES[residual], LOBES[base]
        self.bright_at_horizon = residual != "cosine"
        super().__init__(maps, residual=residual, base=base, **settings)

    def own_specs(self) -> tuple[MapSpec, ...]:
        return (
            MapSpec("lobe", f"global lobe: {', '.join(self._lobe.names)}", layer_channels=len(self._lobe.names), constant=True),
            MapSpec("residual", "residual per term, RGB", layers=self._basis.terms, linear=True),
        )

    @property
    def parameters_by_name(self) -> dict[str, float]:
        """The lobe's parameters by their names."""
        return dict(zip(self._lobe.names, self.maps["lobe"].tolist(), strict=True))

    def srf(self, channel: int) -> Tensor:
        """Return the residual of one colour channel, [K, H, W]: s_r, s_g, s_b of the paper."""
        return self.maps["residual"].unflatten(0, (-1, 3))[:, channel]

    def value(self, light: Tensor, view: Tensor) -> Tensor:
        lobe = self._lobe.evaluate(self.maps["lobe"], light, view)
        return combine(self._basis.evaluate(light, view), self.maps["residual"].unflatten(0, (-1, 3))) + lobe

    def in_one_pass(self, light: Tensor, view: Tensor) -> Tensor | None:
        if self.options["base"] != "phong":
            return None
        return fast_sums.weighed(light, view, self.options["residual"], self.maps["residual"], phong=self.maps["lobe"])
