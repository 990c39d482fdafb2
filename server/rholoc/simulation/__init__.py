"""Simulated rooms, lights and walks: recordings with known truth, for the demo and the tests."""

from rholoc.simulation.light import Light
from rholoc.simulation.rearrangement import rearranged
from rholoc.simulation.recording import PHONE_CAMERA, SimulatedRecording, render_view, simulate_recording
from rholoc.simulation.render import Renderer
from rholoc.simulation.rooms import make_blank_wall, make_test_site
from rholoc.simulation.scene import Building, Scene
from rholoc.simulation.sites import Site, make_site, make_site_walk
from rholoc.simulation.walk import ImuErrors, Motion, Walk, make_walk, measure_imu, measure_waypoints

__all__ = [
    "PHONE_CAMERA",
    "Building",
    "ImuErrors",
    "Light",
    "Motion",
    "Renderer",
    "Scene",
    "SimulatedRecording",
    "Site",
    "Walk",
    "make_blank_wall",
    "make_site",
    "make_site_walk",
    "make_test_site",
    "make_walk",
    "measure_imu",
    "measure_waypoints",
    "rearranged",
    "render_view",
    "simulate_recording",
]
