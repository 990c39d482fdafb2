"""A simulated room, lights and walks through it: recordings with known truth, for the demo and the tests."""

from rholoc.simulation.light import Light
from rholoc.simulation.recording import PHONE_CAMERA, SimulatedRecording, render_view, simulate_recording
from rholoc.simulation.render import Renderer
from rholoc.simulation.rooms import make_blank_wall, make_test_site
from rholoc.simulation.scene import Building, Scene
from rholoc.simulation.walk import ImuErrors, Walk, make_walk, measure_imu, measure_waypoints

__all__ = [
    "PHONE_CAMERA",
    "Building",
    "ImuErrors",
    "Light",
    "Renderer",
    "Scene",
    "SimulatedRecording",
    "Walk",
    "make_blank_wall",
    "make_test_site",
    "make_walk",
    "measure_imu",
    "measure_waypoints",
    "render_view",
    "simulate_recording",
]
