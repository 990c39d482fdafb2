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
        """Name by which users choose the extractor."""
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
        """Faster extractor of fewer features of the same kind, enough for most frames; itself if there is none."""
        ...

    def extract(self, image: ByteArray) -> FeatureSet:
        """The features of an image (H, W, 3) in BGR order or (H, W) grey, uint8."""
        ...


def widened(extractor: Extractor, camera: Camera | None) -> Extractor:
    """Extractor with its limits on features and pixels multiplied by the camera's breadth, for wide pictures.

    The given extractor itself for a pinhole, or if it is not a dataclass.

    Args:
        extractor: extractor for ordinary pictures.
        camera: camera of the pictures; None if unknown, which counts as a pinhole.
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
        """Check that the package is installed.

        Raises:
            NotInstalled: it is not; the hint says how to install it.
        """
        ...


@cache
def _registry() -> dict[str, Extractor]:
    """All extractors by name, installed or not."""
    modules = [
        importlib.import_module(f"{__name__}.{found.name}")
        for found in pkgutil.iter_modules(__path__)
        if not found.name.startswith("_")
    ]
    return {module.EXTRACTOR.name: module.EXTRACTOR for module in modules}


def extractor_names(only_installed: bool = True) -> list[str]:
    """Sorted names of the extractors: of those whose packages are installed, or of all."""
    return sorted(name for name, one in _registry().items() if not only_installed or _is_installed(one))


def get_extractor(name: str) -> Extractor:
    """The extractor called ``name``.

    Raises:
        InvalidInput: there is no extractor of this name.
        NotInstalled: it needs a package that is not installed.
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
