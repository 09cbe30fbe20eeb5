"""Compiles the core when a wheel is built: for this machine, or for the platform whose tag FMUID_WHEEL_TAG names."""

from __future__ import annotations

import importlib.util
import os
import sysconfig
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

NATIVE = Path("fmuid", "simulation", "native")
# The models of the records in fmuid/datasets.
DATASET_MODELS = ("Coil", "FaultyCoil", "InductionMachine")


def build_module(root: Path) -> ModuleType:
    """Return fmuid/simulation/native/build.py, loaded alone: fmuid itself is not installed yet."""
    spec = importlib.util.spec_from_file_location("fmuid_native_build", root / NATIVE / "build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class CoreHook(BuildHookInterface):  # type: ignore[misc]
    """Puts the compiled library into the wheel in place of its sources."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile; `version` is "editable" where the sources are used in place, and then the library lies there."""
        if self.target_name != "wheel":
            return
        build = build_module(Path(self.root))
        if version == "editable":
            build.build_here()
            return
        tag = os.environ.get("FMUID_WHEEL_TAG") or build.tag_here()
        target, ending = build.TARGETS.get(tag, (None, None))
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        library = build.build(Path(self._folder.name) / build.library_name(ending), target)
        build_data["force_include"][str(library)] = str(NATIVE / library.name)
        for model in DATASET_MODELS:
            for name in (f"{model}.fmu", f"{model}.nameplate.toml"):
                if Path(self.root, "fmus", model, name).is_file():
                    build_data["force_include"][f"fmus/{model}/{name}"] = f"fmuid/datasets/{name}"
        build_data["pure_python"] = False
        platform = tag or sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["tag"] = f"py3-none-{platform}"
