"""Base classes and common types of requests and answers: numbers, vectors, intrinsics."""

import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler, Strict
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from rholoc.geometry import CAMERA_WRITTEN, Lens

_LARGEST_SIZE_PX = 2**31
SizePx = Annotated[int, Strict(), Field(ge=-_LARGEST_SIZE_PX, le=_LARGEST_SIZE_PX)]  # Camera checks what is possible
Number = Annotated[float, Strict()]  # neither text nor true and false
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Vector2 = Annotated[list[Number], Field(min_length=2, max_length=2)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


EXAMPLES: dict[str, Any] = json.loads(Path(__file__).parents[1].joinpath("examples.json").read_text(encoding="utf-8"))
"""An example of each model that is sent or received by itself, by the model's name."""


class _Model(BaseModel):
    """Base of all models. Its example, or that of its base, is in the OpenAPI document."""

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = handler(core)
        example = next((EXAMPLES[base.__name__] for base in cls.__mro__ if base.__name__ in EXAMPLES), None)
        if example is not None:
            handler.resolve_ref_schema(schema)["example"] = example
        return schema


class RequestModel(_Model):
    """Base of requests. Unknown members are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class AnswerModel(_Model):
    """Base of answers, made of keywords or of an object with the same attributes."""

    model_config = ConfigDict(frozen=True, from_attributes=True)


CAMERA_TEXT = f"{CAMERA_WRITTEN}, in pixels, or a stored camera's name; default: the recording's own"
"""How users write a recording's camera."""


class CameraIn(RequestModel):
    """Intrinsics in pixels; pixel (0, 0) is the centre of the top-left pixel.

    ``width`` and ``height`` are the size of the images that the intrinsics belong to; for an image of the same aspect
    ratio but another size they are scaled. Without ``fx`` the map's own camera is used if it has the same aspect ratio;
    an equirectangular picture is then a whole panorama.
    """

    width: SizePx | None = Field(default=None, description="px; default: the image's")
    height: SizePx | None = Field(default=None, description="px; default: the image's")
    fx: Number | None = Field(default=None, description="px")
    fy: Number | None = Field(default=None, description="px; default: fx")
    cx: Number | None = Field(default=None, description="px; default: the middle of the image")
    cy: Number | None = Field(default=None, description="px; default: the middle of the image")
    distortion: list[Number] = Field(
        default_factory=list,
        max_length=8,
        description="OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6]]; of a fisheye its k1, k2, k3, k4",
    )
    lens: Lens = Field(default=Lens.PINHOLE, description="how the camera projects")
