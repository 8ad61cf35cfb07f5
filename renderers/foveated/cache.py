"""The cache: how a new sample is weighed against what was reprojected (Weier et al. 2016, 3.4; Yang et al. 2009).

A pixel's cache info is (rho, age): the number of samples accumulated so far (0: none) and frames since one was taken;
alpha follows from them, so that it is not carried along; light has a rho of its own. The paper prints alpha =
min{alpha', k}; its text calls k the *minimum* weight, and with min rho would grow without bound, so it is max here.
"""

from __future__ import annotations

from typing import Any

from renderers.backend import dr, mi
from renderers.image import rgb
from renderers.parameters import Foveated

LEAST_DEPTH = 1e-12


def least_weight(k_min: float, k_max: float, age: Any, t_max: Any) -> Any:
    """k: from ``k_min`` at age 1 geometrically to ``k_max`` at ``t_max`` frames and beyond (Floats)."""
    along = dr.clip((age - 1) / dr.maximum(t_max - 1, 1), 0, 1)
    return dr.select(age >= t_max, k_max, k_min * dr.power(k_max / k_min, along))


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


def merge(
    p: Foveated, pixel: Any, sample: dict[str, Any], overwrite: Any, z_cache: Any, far: Any, t_max: Any,
    buffers: dict[str, Any],
) -> tuple[dict[str, Any], Any]:  # fmt: skip
    """Blend the lanes' samples into the reprojected ``buffers`` (Eq. 1), write what is shown; also gives alpha.

    ``sample``: color, z and, where light is noisy, surface, albedo, light. ``overwrite``: the fovea, marked pixels.
    """
    info = dr.gather(mi.Vector2f, buffers["info"], pixel)
    overwrite = overwrite | ~depth_agrees(sample["z"], z_cache, p.eps_depth, far)
    alpha, rho = weights(info.x, info.y, p.k_min, p.k_max, t_max, overwrite)

    def blended(name: str, new: Any, weight: Any) -> Any:
        old = rgb(dr.gather(mi.Vector4f, buffers[name], pixel))
        value = dr.select(weight >= 1, new, dr.lerp(old, new, weight))
        dr.scatter(buffers[name], mi.Vector4f(value.x, value.y, value.z, 0), pixel)
        return value

    if "light" not in buffers:
        blended("shown", sample["color"], alpha)
    else:
        known = dr.gather(mi.Float, buffers["rho_light"], pixel)
        alpha_light, rho_light = weights(known, info.y, p.light_k_min, p.light_k_max, t_max, overwrite)
        surface, albedo = blended("surface", sample["surface"], alpha), blended("albedo", sample["albedo"], alpha)
        light = blended("light", sample["light"], alpha_light)
        # where nothing is blended, the sample's own colour to the last bit
        color = dr.select((alpha >= 1) & (alpha_light >= 1), sample["color"], surface + albedo * light)
        dr.scatter(buffers["shown"], mi.Vector4f(color.x, color.y, color.z, 0), pixel)
        dr.scatter(buffers["rho_light"], rho_light, pixel)
    dr.scatter(buffers["info"], mi.Vector2f(rho, 0), pixel)
    return buffers, alpha


def first_samples(pixel: Any, sample: dict[str, Any], buffers: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """Write samples where there is no history: each is one of one."""
    named = {"shown": sample["color"]}
    if "light" in buffers:
        named |= {name: sample[name] for name in ("surface", "albedo", "light")}
    for name, value in named.items():
        dr.scatter(buffers[name], mi.Vector4f(value.x, value.y, value.z, 0), pixel)
    if "light" in buffers:
        dr.scatter(buffers["rho_light"], mi.Float(1), pixel)
    dr.scatter(buffers["info"], mi.Vector2f(1, 0), pixel)
    return buffers, dr.select(pixel < 0xFFFFFFFF, mi.Float(1), 0)
