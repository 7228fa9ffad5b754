"""Scenes as TOML files: `read` checks one against the schema below, `write` is its exact inverse.

    name = "lamp and floor"

    [materials.lamp]            # of any name; every key may be left out
    emission = 2.0              # radiance, the same in all directions; 0, or from 1e-9 to 1e9
    [materials.floor]
    lambert = 0.4               # reflectances of the three lobes; they sum to 1 at most
    glossy = 0.2
    exponent = 50               # of the glossy lobe, a whole number from 1 to 200; 20 if left out
    mirror = 0.1

    [[segments]]                # one wall: its front is to the left of the way from start to end
    name = "floor"              # may be left out; no name is taken twice
    material = "floor"
    start = [0, 0]
    end = [4, 0]
    [[segments]]                # or several: a polyline, whose segments are called "cover-1", "cover-2", ...
    name = "cover"
    material = "lamp"
    points = [[2, 2], [1, 2.5], [0, 2]]
    closed = false              # true: the last point is joined to the first; false if left out

    [sensor]
    kind = "pinhole"
    position = [3.5, 1.5]
    direction = [-1, -0.5]      # of any length
    half_angle = 0.6            # in radians; 0.6 if left out
    pixels = 16                 # 16 if left out

or a sensor along a wall, a segment by its name:

    [sensor]
    kind = "wall"
    segment = "floor"
    pixels = 16
"""

import os
import re
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

from mcmc1d.checks import require
from mcmc1d.flatland.scene import Material, Pinhole, Scene, Segment, Wall
from mcmc1d.flatland.schema import (
    FLAG,
    NUMBER,
    POINT,
    POINTS,
    TABLE,
    TEXT,
    WHOLE,
    File,
    Keys,
    Kind,
    Schema,
    exactly,
    nearest,
    text_of,
)
from mcmc1d.flatland.toml_text import basic_string, parse
from mcmc1d.whole import write_whole

_TOP: Schema = {
    "name": TEXT,
    "materials": Kind("tables [materials.NAME]", exactly(dict)),
    "segments": Kind("tables [[segments]], in double brackets", exactly(list)),
    "sensor": Kind("a table [sensor]", exactly(dict)),
}
_MATERIAL: Schema = {
    "emission": NUMBER,
    "lambert": NUMBER,
    "glossy": NUMBER,
    "exponent": WHOLE,
    "mirror": NUMBER,
}
_LINE: Schema = {"name": TEXT, "material": TEXT, "start": POINT, "end": POINT}
_POLYLINE: Schema = {"name": TEXT, "material": TEXT, "points": POINTS, "closed": FLAG}
_SENSORS: Mapping[str, tuple[type, Schema, tuple[str, ...]]] = {
    "pinhole": (
        Pinhole,
        {"kind": TEXT, "position": POINT, "direction": POINT, "half_angle": NUMBER, "pixels": WHOLE},
        ("position", "direction"),
    ),
    "wall": (Wall, {"kind": TEXT, "segment": TEXT, "pixels": WHOLE}, ("segment",)),
}


def read(path: str | os.PathLike[str]) -> Scene:
    """The scene in a TOML file, as this module's docstring describes it.

    Raises `ValueError`, in one line with the file, the line and what to change: the file can not be read or is not
    TOML; a key is unknown (the nearest known one is proposed), missing, or has a value of a wrong type; a material is
    unknown; the scene is none (`Material`, `Pinhole`, `Wall` and `Scene` say why).
    """
    require(isinstance(path, str | os.PathLike), f"read: give the path of a scene's TOML file, not {path!r}")
    file = File(os.fspath(path), text_of(path))
    top = file.table(parse(file.text, file.path), (), "the file", _TOP, tuple(_TOP))
    materials = {}
    for name, table in top["materials"].items():
        keys, what = ("materials", name), f"material {name!r}"
        materials[name] = file.build(Material, file.table(table, keys, what, _MATERIAL), keys, what)
    segments, places = [], []
    for k, table in enumerate(top["segments"]):
        more = _segments(file, table, ("segments", k), materials)
        segments += more
        places += [("segments", k)] * len(more)
    sensor = _sensor(file, top["sensor"])
    try:
        return Scene(top["name"], tuple(segments), sensor)
    except ValueError as error:
        message = str(error).removeprefix(f"scene {top['name']}: ")
        file.fail(_blamed(message, places, segments), message)


def _segments(file: File, table: Any, keys: Keys, materials: Mapping[str, Material]) -> list[Segment]:
    what = "a segment"
    table = file.value(table, keys, what, TABLE)
    polyline = "points" in table
    if polyline and ("start" in table or "end" in table):
        file.fail(keys, f"{what} has both points and start or end; keep one of the two")
    if not polyline and "closed" in table:
        file.fail((*keys, "closed"), f"{what}: only a polyline is closed; give it points, or remove closed")
    if not polyline and not ("start" in table or "end" in table):
        file.table(table, keys, what, {**_LINE, **_POLYLINE}, ("material",))  # a misspelt key comes first
        file.fail(keys, f"{what} has no place: add start = [x, y] and end = [x, y], or points = [[x, y], ...]")
    given = file.table(
        table, keys, what, _POLYLINE if polyline else _LINE, ("material",) if polyline else ("material", "start", "end")
    )
    name, material = given.get("name", ""), given["material"]
    if material not in materials:
        file.fail((*keys, "material"), f"there is no material {material!r}; {nearest(material, materials)}")
    if not polyline:
        return [Segment(given["start"], given["end"], materials[material], name)]
    points = given["points"]
    if given.get("closed", False):
        if len(points) < 3:
            file.fail((*keys, "points"), f"{what}: a closed polyline has three points at least, not {len(points)}")
        points = [*points, points[0]]
    return [
        Segment(start, end, materials[material], f"{name}-{k}" if name else "")
        for k, (start, end) in enumerate(pairwise(points), start=1)
    ]


def _sensor(file: File, table: dict) -> Pinhole | Wall:
    keys: Keys = ("sensor",)
    if "kind" not in table:
        file.fail(keys, 'the sensor lacks \'kind\': add kind = "pinhole" or kind = "wall"')
    kind = file.value(table["kind"], (*keys, "kind"), "the sensor: kind", TEXT)
    if kind not in _SENSORS:
        file.fail((*keys, "kind"), f"there is no sensor of the kind {kind!r}; {nearest(kind, _SENSORS)}")
    build, schema, needed = _SENSORS[kind]
    given = file.table(table, keys, f"the {kind} sensor", schema, needed)
    del given["kind"]
    return file.build(build, given, keys, f"the {kind} sensor")


def _blamed(message: str, places: list[Keys], segments: list[Segment]) -> Keys:
    """Where the fault lies that a scene's message speaks of: the sensor, its first segment, or the segments at all."""
    names = [segment.name for segment in segments]
    if message.startswith("the name"):
        return next(place for k, place in enumerate(places) if names[k] and names[k] in names[:k])
    if message.startswith(("the sensor", "the pinhole")):
        return ("sensor",)
    found = re.match(r"segment (\d+)", message)
    return places[int(found[1])] if found else ("segments",)


def write(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene as TOML, so that `read` returns an equal one to the last bit; an old file is replaced whole.

    Raises `OSError` where the file can not be written.
    """
    names = _material_names(scene)
    parts = [f"name = {basic_string(scene.name)}"]
    for material, name in names.items():
        parts.append(_block(f"[materials.{name}]", _changed(material, Material())))
    for segment in scene.segments:
        named = {"name": segment.name} if segment.name else {}
        place = {"start": segment.start, "end": segment.end}
        parts.append(_block("[[segments]]", {**named, "material": names[segment.material], **place}))
    kind, fields = ("pinhole", "position direction half_angle pixels")
    if isinstance(scene.sensor, Wall):
        kind, fields = ("wall", "segment pixels")
    parts.append(
        _block("[sensor]", {"kind": kind, **{field: getattr(scene.sensor, field) for field in fields.split()}})
    )
    text = "\n\n".join(parts) + "\n"
    write_whole(Path(path), lambda part: part.write_text(text, encoding="utf-8", newline="\n"))


def _material_names(scene: Scene) -> dict[Material, str]:
    """A name for each material by what it does, as lamp, lambert or mixed; numbered from the second of a kind on."""
    names: dict[Material, str] = {}
    for segment in scene.segments:
        material = segment.material
        if material in names:
            continue
        lobes = [lobe for lobe in ("lambert", "glossy", "mirror") if getattr(material, lobe) > 0]
        kind = "lamp" if material.emission > 0 else "black" if not lobes else lobes[0] if len(lobes) == 1 else "mixed"
        count = sum(name.split("-")[0] == kind for name in names.values())
        names[material] = f"{kind}-{count + 1}" if count else kind
    return names


def _changed(value: Material, default: Material) -> dict[str, Any]:
    return {key: getattr(value, key) for key in _MATERIAL if getattr(value, key) != getattr(default, key)}


def _block(header: str, values: Mapping[str, Any]) -> str:
    return "\n".join([header, *(f"{key} = {_literal(key, value)}" for key, value in values.items())])


def _literal(key: str, value: Any) -> str:
    if isinstance(value, str):
        return basic_string(value)
    if isinstance(value, tuple):
        return f"[{', '.join(_literal('', part) for part in value)}]"
    return str(int(value)) if key in ("exponent", "pixels") else repr(float(value))


__all__ = ["read", "write"]
