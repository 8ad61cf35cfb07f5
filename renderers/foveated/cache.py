"""The cache: how a new sample is weighed against what was reprojected (Weier et al. 2016, 3.4; Yang et al. 2009).

A pixel's cache info is (rho, age): the number of samples accumulated so far (0: none) and frames since one was taken;
alpha follows from them, so that it is not carried along; light has a rho of its own. The paper prints alpha =
min{alpha', k}; its text calls k the *minimum* weight, and with min rho would grow without bound, so it is max here.
"""

from __future__ import annotations

import math
from typing import Any

from renderers.backend import dr, mi
from renderers.parameters import Foveated

LEAST_DEPTH = 1e-12


def least_weight(k_min: float, k_max: float, age: Any, t_max: Any) -> Any:
    """k: from ``k_min`` at age 1 geometrically to ``k_max`` at ``t_max`` frames and beyond (Floats)."""
    along = dr.clip((age - 1) / dr.maximum(t_max - 1, 1), 0, 1)
    return dr.select(age >= t_max, k_max, k_min * dr.exp2(along * math.log2(k_max / k_min)))


def weights(rho: Any, age: Any, k_min: float, k_max: float, t_max: Any, overwrite: Any) -> tuple[Any, Any]:
    """(alpha, the new rho) of a sample against a cache of ``rho`` samples that is ``age`` frames old."""
    alone = overwrite | (rho <= 0)
    alpha = dr.maximum(dr.rcp(rho + 1), least_weight(k_min, k_max, age, t_max))
    alpha = dr.select(alone, 1, alpha)
    known = dr.select(alone, 1, rho)
    return alpha, dr.rcp(dr.square(alpha) + dr.square(1 - alpha) / known)


def depth_agrees(z_sample: Any, z_cache: Any, eps_depth: float, far: Any) -> Any:
    """Whether a sample lies on the reprojected surface: |z_s - z_c| <= eps z_s; all beyond ``far`` is background."""
    z_sample, z_cache = dr.minimum(z_sample, far), dr.minimum(z_cache, far)
    return dr.abs(z_sample - z_cache) <= eps_depth * dr.maximum(z_sample, LEAST_DEPTH)


def blend(
    p: Foveated, sample: dict[str, Any], cached: dict[str, Any], overwrite: Any, z_cache: Any, far: Any, t_max: Any
) -> tuple[dict[str, Any], Any]:
    """(what the sample makes of the cached values, alpha): Eq. 1, both caches, new ``rho`` and ``age`` included.

    ``sample``: color, z and, as they are cached, shown or, where light is noisy, surface, albedo, light. ``cached``:
    the same without color and z; rho, age and, where light has its own, rho_light. ``overwrite``: the fovea, marked
    pixels. The resulting ``shown`` is what the eye gets.
    """
    overwrite = overwrite | ~depth_agrees(sample["z"], z_cache, p.eps_depth, far)
    alpha, rho = weights(cached["rho"], cached["age"], p.k_min, p.k_max, t_max, overwrite)

    def blended(old: Any, new: Any, weight: Any) -> Any:
        return dr.select(weight >= 1, new, dr.lerp(old, new, weight))

    out = {"rho": rho, "age": mi.Float(0)}
    if "light" not in cached:
        blend = dr.lerp(cached["shown"], sample["shown"], alpha)
        return out | {"shown": dr.select(alpha >= 1, sample["color"], blend)}, alpha
    k = (p.light_k_min, p.light_k_max)
    if k == (p.k_min, p.k_max):  # the same recursion: both count the same samples
        alpha_light, out["rho_light"] = alpha, rho
    else:
        alpha_light, out["rho_light"] = weights(cached["rho_light"], cached["age"], *k, t_max, overwrite)
    for name, weight in (("surface", alpha), ("albedo", alpha), ("light", alpha_light)):
        out[name] = blended(cached[name], sample[name], weight)
    # where nothing is blended, the sample's own colour to the last bit
    alone = (alpha >= 1) & (alpha_light >= 1)
    out["shown"] = dr.select(alone, sample["color"], out["surface"] + out["albedo"] * out["light"])
    return out, alpha
