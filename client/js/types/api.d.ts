// Written by client/js/write_types.py: run `make format`.

/** Another pose that the frame may have been taken from. */
export interface AlternativeOut {
  /** 0..1, the probability that it is of the right place */
  weight: number;
  pose: PoseOut;
  /** 6×6, as `covariance` of the answer */
  covariance: number[][] | null;
}

/** Intrinsics of a camera, in pixels; pixel (0, 0) is the centre of the top-left pixel. */
export interface Camera {
  width: number;
  height: number;
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  distortion?: number[];
  lens?: Lens;
}

/** Intrinsics, or the name of a stored camera instead: then ``width`` and ``height`` are the image's. */
export interface CameraChoice extends CameraIn {
  /** a stored camera, instead of intrinsics */
  name?: string | null;
}

/** Intrinsics in pixels; pixel (0, 0) is the centre of the top-left pixel. */
export interface CameraIn {
  /** px; default: the image's */
  width?: number | null;
  /** px; default: the image's */
  height?: number | null;
  /** px */
  fx?: number | null;
  /** px; default: fx */
  fy?: number | null;
  /** px; default: the middle of the image */
  cx?: number | null;
  /** px; default: the middle of the image */
  cy?: number | null;
  /** OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6]]; of a fisheye its k1, k2, k3, k4 */
  distortion?: number[];
  /** how the camera projects */
  lens?: Lens;
}

/** Likeliest cause of a refusal. */
export type Cause = "too_dark" | "blurred" | "too_little_texture" | "other_light" | "wrong_camera" | "rolled" | "wrong_gravity" | "wrong_motion" | "too_little_time" | "inexact_map" | "too_inexact" | "unknown_place";

/** One correction, which made a new version of a map. */
export interface Correction {
  version: number;
  kind: CorrectionKind;
  created: string;
  scale?: number | null;
  rotation?: ([number, number, number])[] | null;
  translation?: [number, number, number] | null;
  residual_m?: number | null;
  landmarks_removed?: number;
  views_removed?: number;
}

/** Kind of a correction. */
export type CorrectionKind = "origin" | "north" | "wall" | "up" | "scale" | "plan" | "region" | "walk" | "names" | "floor-plan" | "earth" | "labels";

/** The form of equation (3) that a map's densities take. */
export type DensityKind = "ray" | "tensor" | "observed";

/** The most likely reason why there is no pose, and what to try. */
export interface DiagnosisOut {
  cause: Cause;
  /** one sentence: what it looks like */
  message: string;
  /** one sentence: what to try */
  hint: string;
}

/** Degrees of freedom to estimate. */
export type Dof = "auto" | 5 | 6;

/** A camera on Earth, WGS 84. */
export interface EarthOut {
  latitude_deg: number;
  longitude_deg: number;
  /** above the ellipsoid */
  height_m: number;
  /** where it looks: degrees from true north, clockwise; null where it looks straight up or down */
  heading_deg: number | null;
}

/** The camera as estimated from the picture. */
export interface EstimatedCameraOut {
  width: number;
  height: number;
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  /** one sigma of fx and fy */
  focal_sigma_px: number;
}

/** Type and pose of a floor plan. */
export interface FloorPlan {
  media_type: string;
  corner: [number, number];
  turn_deg: number;
  m_per_unit: number;
}

/** One of several frames that were localized together. */
export interface FramePoseOut {
  pose: PoseOut | null;
  /** how many of its matches agree with the pose */
  inliers: number;
}

/** The rotation of a GeoQuaternion as angles in degrees: about z, the new y, then the new x; 0, 0, 0 looks east. */
export interface GeoAngles {
  /** counter-clockwise from east */
  yaw: number;
  /** downwards */
  pitch: number;
  roll: number;
}

/** The frame that an advanced GeoPose's rotation refers to: east, north and up at the camera. */
export interface GeoFrame {
  authority?: string;
  id?: string;
  /** longitude=…&latitude=…&height=… */
  parameters: string;
}

/** GeoPose, Advanced. */
export interface GeoPoseAdvancedOut {
  frameSpecification: GeoFrame;
  quaternion: GeoQuaternion;
  /** when it was answered, ms since 1970 */
  validTime: number;
}

/** Encoding of a GeoPose. */
export type GeoPoseKind = "quaternion" | "ypr" | "advanced";

/** GeoPose, Basic-Quaternion. */
export interface GeoPoseQuaternionOut {
  position: GeoPosition;
  quaternion: GeoQuaternion;
}

/** GeoPose, Basic-YPR. */
export interface GeoPoseYprOut {
  position: GeoPosition;
  angles: GeoAngles;
}

/** A place, WGS 84. */
export interface GeoPosition {
  /** degrees north */
  lat: number;
  /** degrees east */
  lon: number;
  /** m above the ellipsoid */
  h: number;
}

/** A rotation from the camera's body (x forward, y left, z up) to east, north and up at its place. */
export interface GeoQuaternion {
  x: number;
  y: number;
  z: number;
  w: number;
}

/** Knowledge of the camera's focal length. */
export type Intrinsics = "given" | "unknown";

/** Why a job failed. */
export interface JobError {
  code: string;
  message: string;
  hint: string;
}

/** Kind of a job. */
export type JobKind = "build" | "update" | "learn" | "place";

/** A mapping job. */
export interface JobOut {
  id: string;
  kind: JobKind;
  /** the recording's id; empty where the job needs none */
  recording: string;
  /** the name of the map that it publishes; empty where it places a site's maps */
  map: string;
  /** the site whose maps it places; null where it makes a map */
  site: string | null;
  state: JobState;
  stage: Stage;
  /** 0..1 over all stages */
  progress: number;
  message: string;
  log: string[];
  /** why its published map is not to be trusted, or why maps of its site are not placed */
  warnings: string[];
  /** whether its published map is to be trusted; `warnings` say why not; null before it is published, and for a job that publishes none */
  trusted: boolean | null;
  error: JobError | null;
  /** s since the epoch */
  created: number;
  started: number | null;
  ended: number | null;
  attempts: number;
  priority: JobPriority;
  /** about how much memory it needs; null until its recording was read */
  memory_bytes: number | null;
  /** why no worker can take it, as `message` says: none is running, those that are started die, or none has as much memory; null where one can */
  obstacle: Obstacle | null;
}

/** Priority of a job. */
export type JobPriority = "high" | "normal" | "low";

/** State of a job. */
export type JobState = "queued" | "running" | "published" | "failed" | "cancelled";

/** Projection model of a camera. */
export type Lens = "pinhole" | "fisheye" | "equirectangular";

/** The answer for one frame. ``localized`` false is an answer, not an error. */
export interface LocalizationOut {
  localized: boolean;
  /** why there is no pose, else null */
  reason: Reason | null;
  pose: PoseOut | null;
  /** 6×6, of x, y, z in m and of a small rotation about the map's x, y, z axes in degrees; the map's own uncertainty is part of it */
  covariance: number[][] | null;
  /** 0..1, the probability that the pose is of the right place: within 50 cm and 20° of the truth, the map's errors included; `localized` goes by it */
  recognized: number;
  /** 0..1, the probability that the pose is within 10 cm and 5° of the truth, the map's errors included: at most `recognized` */
  confidence: number;
  /** at most four other poses that the frame may have been taken from, the likeliest first; a pose that was withheld as not recognized is the first of them */
  alternatives: AlternativeOut[];
  matches: number;
  inliers: number;
  map: string;
  map_id: string;
  map_version: number;
  /** 'arbitrary': the map's unit of length is not the metre */
  scale: Scale;
  /** whether the frame poses that the map was built on passed every check; null where it does not say */
  map_trusted: boolean | null;
  /** how far the map itself is expected to be off here, root mean square, m; null where it is not known */
  expected_error_m: number | null;
  /** the matches behind `inliers`, where `with_matches` asks for them */
  agreeing: MatchesOut | null;
  /** the most likely cause where there is no pose, else null */
  diagnosis: DiagnosisOut | null;
  /** whether the pose is within the prior's radii; null without a prior */
  near_prior: boolean | null;
  /** where `intrinsics` is 'unknown': the camera as estimated */
  camera: EstimatedCameraOut | null;
  /** the named areas of the map that the camera is in, the smallest first */
  areas: string[];
  /** its named points within 2 m of the camera, the nearest first */
  near: string[];
  /** each frame's pose where several were sent; `pose` is the first one's */
  frames?: FramePoseOut[] | null;
  /** the pose in the frame of the map's site; null without one */
  site?: SitePoseOut | null;
  /** the camera on Earth as OGC GeoPose 1.0, where `geopose` asks for it and the map or its site has a place on Earth; the body's axes are x forward, y left, z up */
  geopose?: GeoPoseQuaternionOut | GeoPoseYprOut | GeoPoseAdvancedOut | null;
  /** milliseconds: queue, load (of a map that was not in memory), decode, extract, match, seed, ascend, verify, diagnose, total; in a large map also place, which finds the place first; of more than five maps also choose, which finds those to ask */
  timings_ms: Record<string, number>;
}

/** How to localize one frame: the part ``request`` of a multipart body. */
export interface LocalizeOptions {
  camera?: CameraChoice;
  /** 'auto': 6, roll being improbable where the map's own views were upright; 5: the camera does not roll; 6: roll is estimated too */
  dof?: Dof;
  /** 'unknown': the focal length is estimated along with the pose; then no camera may be given but its width and height */
  intrinsics?: Intrinsics;
  prior?: PriorIn | null;
  /** the direction of gravity (down) in the camera frame */
  gravity?: number[] | null;
  /** how long the answer may take */
  deadline_ms?: number | null;
  /** the position's greatest standard deviation along any axis, m; a less exact pose is withheld */
  max_sigma_m?: number | null;
  /** the rotation's, degrees; a less exact pose is withheld */
  max_sigma_deg?: number | null;
  /** whether the answer lists the matches that agree with the pose */
  with_matches?: boolean;
  /** the answer has a GeoPose, if the map or its site has a place on Earth */
  geopose?: GeoPoseKind | null;
}

/** A map with its sources and its extent. */
export interface MapDetail extends MapSummary {
  sources: Source[];
  waypoints: MapWaypoint[];
  /** the lowest and the highest x, y, z of its landmarks */
  bounds_m: number[][] | null;
  /** the map that it replaced, which can be restored */
  previous: PreviousMap | null;
  /** of points and areas */
  names: MapNames;
  /** what people corrected in it, the latest last */
  corrections: Correction[];
  /** the floor plan that it keeps, and where it lies; null where there is none */
  plan: FloorPlan | null;
  /** where its frame lies on Earth (WGS 84; heading of its y axis from true north); null where unknown */
  earth: SiteOnEarth | null;
  /** how many further points of the room it keeps, for people to see */
  points: number;
  /** whether it keeps pictures of its views, and this server shows them */
  pictures: boolean;
  /** 3×3, a rotation of the map for display that makes up z and walls parallel to x and y, both as estimated; null where the map is upright, or where up cannot be estimated */
  levelling: number[][] | null;
  /** whether this server keeps refused pictures */
  keeps_refused?: boolean;
  /** whether this server shows who asks for poses in it */
  live?: boolean;
  /** whether this server keeps where requests fail in it */
  keeps_failures?: boolean;
}

/** Labels by which lists of maps are grouped and searched. */
export interface MapLabels {
  site?: string;
  floor?: string;
  tags?: string[];
}

/** All names of a map. */
export interface MapNames {
  points?: NamedPoint[];
  areas?: NamedArea[];
}

/** A map in a list. */
export interface MapSummary {
  name: string;
  /** unique for each built map */
  id: string;
  version: number;
  density: DensityKind;
  /** the extractor's name */
  features: string;
  scale: Scale;
  /** whether z points up */
  upright: boolean;
  /** when this version was made, ISO 8601, UTC */
  created: string;
  /** how many features it holds */
  landmarks: number;
  /** how many keyframes it was seen from */
  views: number;
  /** how many vertices the surfaces of its room have; 0 until they are drawn */
  room: number;
  size_bytes: number;
  /** whether the frame poses that it was built on passed every check; null where it does not say */
  trusted: boolean | null;
  /** why it is trusted, or which checks failed */
  trust_reason: string;
  /** how far its poses are expected to be from the truth, root mean square, m; null where unknown */
  expected_error_m: number | null;
  /** median distance, m, between where frames of the walk that were held out of the map are localized and where the walk has them: how well the map agrees with itself, not how right it is; null if none were held out */
  consistency_m: number | null;
  camera: CameraIn;
  /** its site, floor and tags, as people set them */
  labels: MapLabels;
}

/** A measured point of a map's recordings. */
export interface MapWaypoint {
  name: string;
  position: [number, number, number];
  residual_m?: number | null;
}

/** The matches that agree with a pose: one entry of each list per match. */
export interface MatchesOut {
  /** u and v of the feature in the frame, px */
  pixels: number[][];
  /** x, y, z of the landmark in the map, m */
  landmarks: number[][];
}

/** An area with a name, seen from above. */
export interface NamedArea {
  name: string;
  outline: ([number, number])[];
  kind?: string;
  fields?: Record<string, string | number | boolean | null>;
}

/** A point with a name. */
export interface NamedPoint {
  name: string;
  position: [number, number, number];
  kind?: string;
  fields?: Record<string, string | number | boolean | null>;
}

/** Why no worker can take a queued job. */
export type Obstacle = "no_worker" | "worker_fails" | "memory";

/** A pose in the map frame (right-handed, z up). */
export interface PoseOut {
  /** the camera's centre: x, y, z in m */
  position: number[];
  /** the optical axis, unit length */
  heading: number[];
  /** the rotation about the heading against the upright camera */
  roll_deg: number;
  /** R_map_camera as x, y, z, w */
  quaternion_xyzw: number[];
  /** 4×4, takes points of the camera frame to the map frame */
  T_map_camera: number[][];
}

/** The map that a map replaced. */
export interface PreviousMap {
  /** the number that restores it: 1 was replaced last */
  number?: number;
  id: string;
  version: number;
  /** ISO 8601, UTC */
  created: string;
}

/** The pose near which the answer is expected: a position and either a heading or a quaternion. */
export interface PriorIn {
  /** m, map frame */
  position: number[];
  /** the optical axis in the map frame */
  heading?: number[] | null;
  /** of R_map_camera */
  quaternion_xyzw?: number[] | null;
  /** how far the position may be from it, m */
  radius_m?: number;
  /** how far the heading may be from it, degrees */
  radius_deg?: number;
}

/** Reason for a refusal. */
export type Reason = "no_features" | "no_matches" | "no_agreement" | "not_recognized" | "too_inexact" | "deadline";

/** What the map's unit of length is. */
export type Scale = "metric" | "arbitrary";

/** Pose of a site's or a map's frame on Earth; its z axis is up. */
export interface SiteOnEarth {
  latitude_deg: number;
  longitude_deg: number;
  height_m?: number;
  heading_deg?: number;
}

/** The pose in the frame of a site that the map belongs to. */
export interface SitePoseOut {
  site: string;
  /** of the site */
  version: number;
  /** the map's; empty where it is not said */
  floor: string;
  /** the camera's centre: x, y, z in m */
  position: number[];
  /** the optical axis, unit length */
  heading: number[];
  /** R_site_camera as x, y, z, w */
  quaternion_xyzw: number[];
  /** as `covariance` of the answer, in the site's axes; how well the map is placed is part of it */
  covariance: number[][] | null;
  /** the same on Earth; null where nobody said where the site lies */
  earth: EarthOut | null;
}

/** A recording, or a table, that a map was made from. */
export interface Source {
  name: string;
  id?: string | null;
  camera?: Camera | null;
  frames?: number | null;
  posed?: number | null;
  views?: number | null;
  held_out?: number | null;
  poses?: string | null;
}

/** The stages of a mapping job, in order. */
export type Stage = "received" | "read" | "keyframes" | "features" | "poses" | "observations" | "densities" | "report" | "links" | "published";
