# SPDX-License-Identifier: BSD-3-Clause
"""Our own calibration files: YAML or JSON with the class names and parameters of the models."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from epi360.cameras.base import Camera
from epi360.cameras.calibration import fields
from epi360.cameras.double_sphere import DoubleSphere
from epi360.cameras.equirectangular import Equirectangular
from epi360.cameras.extended_unified import ExtendedUnified
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.pinhole import Pinhole
from epi360.cameras.unified import UnifiedCamera

MODELS: dict[str, type[Camera]] = {
    model.__name__: model
    for model in (
        Equirectangular,
        Pinhole,
        KannalaBrandt,
        UnifiedCamera,
        ExtendedUnified,
        DoubleSphere,
    )
}


def fits(document: Any) -> bool:
    """Whether the content is a mapping of ours."""
    return isinstance(document, Mapping) and ("model" in document or "cameras" in document)


def read(document: Mapping[str, Any]) -> dict[str, Camera]:
    """Cameras of such a mapping; a single one is called "camera"."""
    if "model" in document:
        return {"camera": _camera(document)}
    unknown = [str(key) for key in document if key != "cameras"]
    if unknown:
        raise ValueError(f"unknown keys beside 'cameras': {', '.join(unknown)}")
    return fields.each(document["cameras"], _camera)


def _camera(entry: Mapping[str, Any]) -> Camera:
    name = entry.get("model")
    if not isinstance(name, str) or name not in MODELS:
        raise fields.unsupported(f"model {fields.shortened(name)}", ", ".join(MODELS))
    parameters = {field.name: field for field in dataclasses.fields(MODELS[name])}
    unknown = [str(key) for key in entry if key != "model" and key not in parameters]
    if unknown:
        known = ", ".join(parameters)
        raise ValueError(f"unknown keys for {name}: {', '.join(unknown)}; it has {known}")
    needed = [key for key, field in parameters.items() if field.default is dataclasses.MISSING]
    fields.check_has(entry, needed)
    return MODELS[name](**{key: fields.number(entry[key]) for key in entry if key != "model"})
