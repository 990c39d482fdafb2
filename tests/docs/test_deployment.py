"""Descriptions of deployments: well-formed, and about this service."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from rholoc.service import Settings, create_app

_ROOT = Path(__file__).parents[2]
_DEPLOY = _ROOT / "server" / "deploy"


@pytest.fixture(scope="module")
def manifests() -> list[dict[str, Any]]:
    return list(yaml.safe_load_all((_DEPLOY / "kubernetes.yaml").read_text(encoding="utf-8")))


def test_manifests_are_as_kubernetes_takes_them(manifests: list[dict[str, Any]]) -> None:
    for manifest in manifests:
        kubernetes_validate.validate(manifest, "1.30", strict=True)


@pytest.mark.parametrize("path", ["compose.yaml", "server/deploy/compose.yaml"])
def test_compose_files_are_as_compose_takes_them(path: str) -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec", str(_ROOT / path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("path", sorted(_DEPLOY.iterdir()) if _DEPLOY.is_dir() else [], ids=lambda path: path.name)
def test_only_settings_that_there_are_are_set(path: Path) -> None:
    named = set(re.findall(r"\bRHOLOC_([A-Z_]+)", path.read_text(encoding="utf-8")))
    proxy = {"SITE", "SERVERS", "SERVERS_PORT"}
    assert {name.lower() for name in named - proxy} <= set(Settings.model_fields)


def test_probes_ask_routes_that_there_are(manifests: list[dict[str, Any]]) -> None:
    asked = set(re.findall(r'"path": "(/[a-z]+)"', json.dumps(manifests)))
    documented = set(create_app().openapi()["paths"])
    assert {"/healthz", "/readyz"} <= asked <= documented | {"/"}


def test_containers_run_as_the_image_does(manifests: list[dict[str, Any]]) -> None:
    dockerfile = (_ROOT / "Dockerfile").read_text(encoding="utf-8")
    pods = [manifest["spec"]["template"]["spec"] for manifest in manifests if manifest["kind"] == "Deployment"]
    assert len(pods) == 2
    for pod in pods:
        assert f"--uid {pod['securityContext']['runAsUser']} " in dockerfile
        assert {mount["mountPath"] for mount in pod["containers"][0]["volumeMounts"]} == {"/data", "/tmp"}


def test_what_the_autoscalers_look_at_is_measured(manifests: list[dict[str, Any]]) -> None:
    names = set(re.findall(r'"metric": \{"name": "([a-z_]+)"', json.dumps(manifests)))
    source = (_ROOT / "server" / "rholoc" / "service" / "app.py").read_text(encoding="utf-8")
    assert names == {"rholoc_frames", "rholoc_jobs"}
    assert all(f'gauge("{name}"' in source for name in names)
