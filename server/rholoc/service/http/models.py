"""What the models of requests and answers share: their bases, numbers and vectors, intrinsics."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, JsonValue, Strict
from pydantic.config import JsonDict

_LARGEST_SIZE_PX = 2**31
SizePx = Annotated[int, Strict(), Field(ge=-_LARGEST_SIZE_PX, le=_LARGEST_SIZE_PX)]  # Camera checks what is possible
Number = Annotated[float, Strict()]  # neither text nor true and false
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Vector2 = Annotated[list[Number], Field(min_length=2, max_length=2)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]

MAP_ID_EXAMPLE = "4f1c2a9be07d4d0c8f5f6f0f3f1f7a11"
CAMERA_EXAMPLE: JsonDict = {
    "width": 640,
    "height": 480,
    "fx": 525.5,
    "fy": 525.5,
    "cx": 320.0,
    "cy": 240.0,
    "distortion": [],
}


def example(value: JsonValue) -> ConfigDict:
    """``model_config`` of a model whose example in the OpenAPI document is ``value``."""
    return ConfigDict(json_schema_extra={"example": value})


class RequestModel(BaseModel):
    """Base of what clients send. Unknown members are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class AnswerModel(BaseModel):
    """Base of what clients are sent, made of keywords or of an object with the same attributes."""

    model_config = ConfigDict(frozen=True, from_attributes=True)


class CameraIn(RequestModel):
    """Intrinsics in pixels; pixel (0, 0) is the centre of the top-left pixel.

    ``width`` and ``height`` are the size of the images that the intrinsics belong to; for an image of the same aspect
    ratio but another size they are scaled. Without ``fx`` the map's own camera is used if it has the same aspect ratio.
    """

    model_config = example(CAMERA_EXAMPLE)

    width: SizePx | None = Field(default=None, description="px; default: the image's")
    height: SizePx | None = Field(default=None, description="px; default: the image's")
    fx: Number | None = Field(default=None, description="px")
    fy: Number | None = Field(default=None, description="px; default: fx")
    cx: Number | None = Field(default=None, description="px; default: the middle of the image")
    cy: Number | None = Field(default=None, description="px; default: the middle of the image")
    distortion: list[Number] = Field(
        default_factory=list, max_length=8, description="OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6]]"
    )
