"""The messages of a stream of frames (a WebSocket), as JSON text; pictures are binary messages between them."""

from typing import Annotated, Literal

from pydantic import Field

from rholoc.localization import Dof
from rholoc.service.frames.answer_models import LocalizationOut, PoseOut
from rholoc.service.frames.request_models import CameraChoice
from rholoc.service.http.models import Number, Quaternion, RequestModel, Vector3
from rholoc.trajectory import Scale
from rholoc_client.tracking import TrackStatus

_MAX_READINGS = 2000
_Reading = Annotated[list[Number], Field(min_length=7, max_length=7)]


class OdometryNoiseIn(RequestModel):
    """How accurate the odometry is: one sigma each."""

    drift: float = Field(default=0.02, ge=0, le=1, description="of a distance, as a share of it")
    turn_drift: float = Field(default=0.01, ge=0, le=1, description="of an angle, as a share of it")
    heading_drift_deg_m: float = Field(default=0.5, ge=0, le=90, description="of the heading after a metre, degrees")


class Begin(RequestModel):
    """The first message: what holds for all frames."""

    type: Literal["begin"]
    camera: CameraChoice = Field(default_factory=CameraChoice)
    dof: Dof = Dof.AUTO
    odometry: OdometryNoiseIn = Field(default_factory=OdometryNoiseIn)


class OdometryPose(RequestModel):
    """Where odometry has the camera, in its own frame."""

    position: Vector3
    quaternion_xyzw: Quaternion


class FrameMessage(RequestModel):
    """A frame; with ``picture`` the next message is its JPEG, PNG or WebP, as binary."""

    type: Literal["frame"]
    time_s: Number = Field(description="on any one clock that goes forward")
    odometry: OdometryPose | None = None
    imu: list[_Reading] = Field(
        default_factory=list,
        max_length=_MAX_READINGS,
        description="readings since the frame before: time_s, acceleration x, y, z in m/s², rate x, y, z in rad/s, in "
        "the camera's axes (x right, y down, z forward)",
    )
    picture: bool = False


class Begun(RequestModel):
    """The answer to the first message."""

    type: Literal["begun"] = "begun"
    map: str
    map_id: str
    map_version: int
    scale: Scale


class TrackedOut(RequestModel):
    """The answer to a frame; also sent when a later answer changes what is known of the last one."""

    type: Literal["tracked"] = "tracked"
    time_s: float
    status: TrackStatus
    pose: PoseOut | None
    covariance: list[list[float]] | None
    T_map_odom: list[list[float]] | None
    T_map_odom_covariance: list[list[float]] | None
    reset_counter: int
    since_answer_s: float | None
    answers: int
    rejected: int
    wants_picture: bool
    answer: LocalizationOut | None = None


class StreamError(RequestModel):
    """The last message of a stream that cannot go on."""

    type: Literal["error"] = "error"
    code: str
    message: str
    hint: str
    request_id: str
