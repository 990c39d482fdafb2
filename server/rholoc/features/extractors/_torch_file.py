"""Arrays out of a file that PyTorch saved, without PyTorch and without running anything that the file names."""

import pickle
import zipfile
from collections import OrderedDict
from typing import IO, Any

import numpy as np

from rholoc.geometry import FloatArray

_NUMBERS = {"FloatStorage": np.dtype("<f4"), "LongStorage": np.dtype("<i8")}


def read_torch_file(file: IO[bytes]) -> dict[str, FloatArray]:
    """The named tensors of a saved state, as arrays.

    The file is a ZIP archive of a pickle with names and shapes, and of one entry of numbers for each tensor. Only
    dictionaries and arrays are unpickled.

    Raises:
        ValueError: the file has another format.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            listing = next(name for name in archive.namelist() if name.endswith("/data.pkl"))
            with archive.open(listing) as pickled:
                state = _Unpickler(pickled, archive, listing.removesuffix("data.pkl")).load()
    except (zipfile.BadZipFile, StopIteration, KeyError, pickle.UnpicklingError, EOFError) as error:
        raise ValueError("This is not a file of tensors.") from error
    return {str(name): array for name, array in state.items()}


class _Unpickler(pickle.Unpickler):
    """Tensors as arrays; refuses everything else that a pickle may name."""

    def __init__(self, pickled: IO[bytes], archive: zipfile.ZipFile, folder: str) -> None:
        super().__init__(pickled)
        self._archive, self._folder = archive, folder

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _array
        if module == "torch" and name in _NUMBERS:
            return _NUMBERS[name]
        raise pickle.UnpicklingError(f"{module}.{name} is no part of a tensor.")

    def persistent_load(self, pid: Any) -> np.ndarray:
        """All numbers of the storage that a tensor refers to, flat."""
        _, dtype, key, *_ = pid
        return np.frombuffer(self._archive.read(f"{self._folder}data/{key}"), dtype)


def _array(storage: np.ndarray, offset: int, shape: tuple[int, ...], strides: tuple[int, ...], *_: Any) -> np.ndarray:
    """PyTorch's tensor as an array: ``offset`` and ``strides`` are counted in numbers of ``storage``, not in bytes."""
    bytes_apart = tuple(storage.itemsize * stride for stride in strides)
    return np.ascontiguousarray(np.ndarray(shape, storage.dtype, storage, storage.itemsize * offset, bytes_apart))
