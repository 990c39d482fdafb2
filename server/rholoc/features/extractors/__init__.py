"""The extractors: one module each. A new one is one new file that defines ``EXTRACTOR``."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import is_dataclass, replace
from functools import cache
from typing import Protocol, runtime_checkable

from rholoc.errors import InvalidInput, NotInstalled
from rholoc.features.feature_set import Channel, FeatureSet, Metric
from rholoc.geometry import ByteArray, Camera

DEFAULT_FEATURES = "sift48"
"""Extractor of new maps, unless another one is asked for."""


class Extractor(Protocol):
    """Image → features. Stateless and safe to call from several threads."""

    @property
    def name(self) -> str:
        """The name by which users choose it: that of its module."""
        ...

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels its features come from."""
        ...

    @property
    def metric(self) -> Metric:
        """Metric between its descriptors."""
        ...

    @property
    def descriptor_bytes(self) -> int:
        """Length of its descriptors [bytes]."""
        ...

    @property
    def quick(self) -> Extractor:
        """An extractor of fewer features of the same kind in less time, enough for most frames; or this one itself."""
        ...

    def extract(self, image: ByteArray) -> FeatureSet:
        """The features of an image (H, W, 3) in BGR order or (H, W) grey, uint8."""
        ...


def widened(extractor: Extractor, camera: Camera | None) -> Extractor:
    """Extractor with limits multiplied by the camera's breadth, to find as much in every part of a wide picture; itself
    for a pinhole, or if it is no dataclass.

    Args:
        extractor: for ordinary pictures.
        camera: of the pictures, None where the lens is unknown: taken for a pinhole.
    """
    breadth = 1.0 if camera is None else camera.breadth
    if breadth == 1 or not is_dataclass(extractor) or isinstance(extractor, type):
        return extractor
    limits = {name: getattr(extractor, name, None) for name in ("features", "longest_px", "quick_px")}
    return replace(extractor, **{name: round(breadth * limit) for name, limit in limits.items() if limit is not None})


@runtime_checkable
class NeedsPackage(Protocol):
    """An extractor that needs a package which not every installation has."""

    def check_installed(self) -> None:
        """Do nothing where the package is there.

        Raises:
            NotInstalled: it is not; the hint says how to install it.
        """
        ...


@cache
def _registry() -> dict[str, Extractor]:
    modules = [
        importlib.import_module(f"{__name__}.{found.name}")
        for found in pkgutil.iter_modules(__path__)
        if not found.name.startswith("_")
    ]
    return {module.EXTRACTOR.name: module.EXTRACTOR for module in modules}


def extractor_names(only_installed: bool = True) -> list[str]:
    """The names of the extractors that can be used here, or of all, sorted."""
    return sorted(name for name, one in _registry().items() if not only_installed or _is_installed(one))


def get_extractor(name: str) -> Extractor:
    """The extractor called ``name``.

    Raises:
        InvalidInput: there are no features of this name.
        NotInstalled: they need a package that is not here.
    """
    if name not in _registry():
        raise InvalidInput(f"There are no features called '{name}'.", f"Choose one of {', '.join(extractor_names())}.")
    extractor = _registry()[name]
    if isinstance(extractor, NeedsPackage):
        extractor.check_installed()
    return extractor


def _is_installed(extractor: Extractor) -> bool:
    try:
        if isinstance(extractor, NeedsPackage):
            extractor.check_installed()
    except NotInstalled:
        return False
    return True
