"""The models of a request for a pose: options, cameras, priors, descriptor sets, several frames."""

from typing import Annotated

from pydantic import FailFast, Field

from rholoc.features import Channel
from rholoc.localization import Dof, Intrinsics
from rholoc.service.frames.geoposes import GeoPoseKind
from rholoc.service.http.models import CameraIn, Number, Quaternion, RequestModel, Vector3

DeadlineMs = Annotated[float | None, Field(gt=0, le=600_000, description="how long the answer may take")]
MaxSigmaM = Annotated[
    float | None,
    Field(
        gt=0,
        le=1000,
        description="the position's greatest standard deviation along any axis, m; a less exact pose is withheld",
    ),
]
MaxSigmaDeg = Annotated[
    float | None, Field(gt=0, le=180, description="the rotation's, degrees; a less exact pose is withheld")
]


GeoPose = Annotated[
    GeoPoseKind | None,
    Field(description="the answer has a GeoPose, if the map or its site has a place on Earth"),
]


class CameraChoice(CameraIn):
    """Intrinsics, or the name of a stored camera instead: then ``width`` and ``height`` are the image's."""

    name: str | None = Field(default=None, description="a stored camera, instead of intrinsics")


class PriorIn(RequestModel):
    """The pose near which the answer is expected: a position and either a heading or a quaternion."""

    position: Vector3 = Field(description="m, map frame")
    heading: Vector3 | None = Field(default=None, description="the optical axis in the map frame")
    quaternion_xyzw: Quaternion | None = Field(default=None, description="of R_map_camera")
    radius_m: float = Field(default=1.0, gt=0, description="how far the position may be from it, m")
    radius_deg: float = Field(default=35.0, gt=0, le=180, description="how far the heading may be from it, degrees")


class LocalizeOptions(RequestModel):
    """How to localize one frame: the part ``request`` of a multipart body."""

    camera: CameraChoice = Field(default_factory=CameraChoice)
    dof: Dof = Field(
        default=Dof.AUTO,
        description="'auto': 6, roll being improbable where the map's own views were upright; 5: the camera does not "
        "roll; 6: roll is estimated too",
    )
    intrinsics: Intrinsics = Field(
        default=Intrinsics.GIVEN,
        description="'unknown': the focal length is estimated along with the pose; then no camera may be given but its "
        "width and height",
    )
    prior: PriorIn | None = None
    gravity: Vector3 | None = Field(default=None, description="the direction of gravity (down) in the camera frame")
    deadline_ms: DeadlineMs = None
    max_sigma_m: MaxSigmaM = None
    max_sigma_deg: MaxSigmaDeg = None
    with_matches: bool = Field(
        default=False, description="whether the answer lists the matches that agree with the pose"
    )
    geopose: GeoPose = None


class FirstError(FailFast):
    """Reports a list's first error, not each of a million."""

    __hash__ = object.__hash__  # which a union needs


class FeaturesIn(RequestModel):
    """The features of one frame, as the map's own extractor finds them: one entry of each list per feature."""

    pixels: Annotated[list[tuple[float, float]], FirstError()] = Field(description="u and v of each feature, px")
    descriptors: Annotated[list[str], FirstError()] | str = Field(
        description="one string of hex digits per feature, or all descriptors in a row as one base64 string"
    )
    channels: Annotated[list[int | str], FirstError()] | None = Field(
        default=None,
        description="each feature's channel by number or name: "
        + ", ".join(f"{channel.value} {channel.name}" for channel in Channel)
        + ". May be left out where the map has one channel only.",
    )
    sizes_px: Annotated[list[float], FirstError()] | None = Field(
        default=None, description="the diameter of each described patch, px; 0 where unknown"
    )
    angles_deg: Annotated[list[float | None], FirstError()] | None = Field(
        default=None, description="each patch's orientation, degrees clockwise from +u; null where unknown"
    )


class DescriptorQuery(LocalizeOptions):
    """A frame by its features alone: the picture stays with the robot."""

    features: FeaturesIn


class FrameIn(RequestModel):
    """One of several frames: a picture or a descriptor set, and where its camera was relative to the others."""

    camera: CameraChoice | None = Field(default=None, description="its intrinsics; default: the request's `camera`")
    image: str | None = Field(
        default=None, description="a JPEG or PNG as base64; in a multipart body a part `image0`, `image1`, … instead"
    )
    features: FeaturesIn | None = Field(default=None, description="its features, instead of an image")
    position: Vector3 = Field(description="of the camera in the frames' common frame, m")
    quaternion_xyzw: Quaternion = Field(description="of its rotation, R_common_camera")
    gravity: Vector3 | None = Field(default=None, description="the direction of gravity (down) in the camera frame")


class FramesQuery(RequestModel):
    """2 to 10 frames whose poses relative to each other are known: a rig's cameras, or one camera with odometry."""

    frames: list[FrameIn]
    camera: CameraChoice = Field(default_factory=CameraChoice, description="of frames that name none of their own")
    dof: Dof = Dof.AUTO
    sigma_m: Number = Field(default=0.005, description="one sigma of a frame's position as its predecessor sees it, m")
    sigma_deg: Number = Field(default=0.2, description="one sigma of its rotation, degrees")
    deadline_ms: DeadlineMs = None
    max_sigma_m: MaxSigmaM = None
    max_sigma_deg: MaxSigmaDeg = None
    geopose: GeoPose = None
