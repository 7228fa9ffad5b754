"""Scene files: exact round trips, and one line with the place and the fix for whatever is wrong with one."""

import re
from dataclasses import replace

import numpy as np
import pytest

from mcmc1d.flatland.files import read, write
from mcmc1d.flatland.scene import Material, Pinhole, Scene, Segment, Wall
from mcmc1d.flatland.scenes import catalogue
from mcmc1d.flatland.toml_text import line_of

GOOD = """\
name = "small"

[materials.lamp]   # line 3
emission = 2
[materials.grey]   # line 5
lambert = 0.4
exponent = 30

[[segments]]       # line 9
name = "floor"
material = "grey"
start = [0, 0]
end = [4, 0]

[[segments]]       # line 15
name = "cover"
material = "lamp"
points = [[2, 2], [1, 2.5], [0, 2]]

[sensor]           # line 20
kind = "pinhole"
position = [3.5, 1.5]
direction = [-1, -0.5]
"""
WALL = 'kind = "wall"\nsegment = "floor"\n'
PINHOLE = GOOD[GOOD.index("kind =") :]


def given(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


# --- what a file says -----------------------------------------------------------------------------------------------


def test_a_file_is_read_as_it_says(tmp_path):
    lamp, grey = Material(emission=2.0), Material(lambert=0.4, exponent=30)
    expected = Scene(
        "small",
        (
            Segment((0.0, 0.0), (4.0, 0.0), grey, "floor"),
            Segment((2.0, 2.0), (1.0, 2.5), lamp, "cover-1"),
            Segment((1.0, 2.5), (0.0, 2.0), lamp, "cover-2"),
        ),
        Pinhole((3.5, 1.5), (-1.0, -0.5), 0.6, 16),
    )
    assert read(given(tmp_path, GOOD)) == expected
    assert read(str(given(tmp_path, GOOD))) == expected
    assert read(given(tmp_path, b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())) == expected
    closed = read(given(tmp_path, GOOD.replace("[0, 2]]", "[0, 2]]\nclosed = true")))
    assert closed.segments[3] == Segment((0.0, 2.0), (2.0, 2.0), lamp, "cover-3")
    assert read(given(tmp_path, GOOD.replace(PINHOLE, WALL))).sensor == Wall("floor", 16)


def test_a_scene_in_one_statement_is_read_too(tmp_path):
    text = """
    name = 'inline'
    materials = { lamp = { emission = 1 } }
    segments = [
      { material = 'lamp', start = [0, 0], end = [1, 0] },
    ]
    sensor = { kind = 'pinhole', position = [0.5, 1], direction = [0, -1], pixels = 3 }
    """
    found = read(given(tmp_path, text))
    assert found.segments == (Segment((0.0, 0.0), (1.0, 0.0), Material(1.0)),)
    assert found.sensor.pixels == 3


# --- round trips ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", catalogue())
def test_the_catalogue_is_written_and_read_to_the_last_bit(tmp_path, name):
    scene = catalogue()[name]()
    write(scene, tmp_path / "a.toml")
    again = read(tmp_path / "a.toml")
    assert again == scene
    assert np.array_equal(again.ends, scene.ends)
    write(again, tmp_path / "b.toml")
    assert (tmp_path / "a.toml").read_bytes() == (tmp_path / "b.toml").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.toml", "b.toml"]


def test_awkward_numbers_and_names_survive(tmp_path):
    rng = np.random.default_rng(0)
    materials = [Material(1.5e-8), Material(emission=1e9 / 7, lambert=1 / 3, glossy=0.1, exponent=200, mirror=0.2)]
    materials += [Material(lambert=float(x)) for x in rng.random(4)]
    names = ["", 'quote " and \\', "new\nline\ttab", "\x7f\x00\u2028", "ärger 🙂 # [x] = 'y'", "-"]
    segments = tuple(
        Segment((np.float64(k) + 1 / 3, -0.0), (k + 1, 1e-7 * float(x)), material, name)
        for k, (material, name, x) in enumerate(zip(materials, names, rng.random(6) + 1, strict=True))
    )
    for sensor in (Pinhole((np.float64(0.1), 5), (1e-9, -1 / 7), np.float64(0.1), 7), Wall(names[4], 1)):
        scene = Scene('a "name"\n', segments, sensor)
        write(scene, tmp_path / "scene.toml")
        assert read(tmp_path / "scene.toml") == scene
        assert np.signbit(read(tmp_path / "scene.toml").ends[0, 0, 1])


def test_a_failed_write_leaves_the_old_file(tmp_path):
    scene = read(given(tmp_path, GOOD))
    write(scene, tmp_path / "scene.toml")
    before = (tmp_path / "scene.toml").read_bytes()
    with pytest.raises(UnicodeEncodeError):
        write(replace(scene, name="\ud800"), tmp_path / "scene.toml")
    assert (tmp_path / "scene.toml").read_bytes() == before


# --- bad input ------------------------------------------------------------------------------------------------------

WRONG = {
    # what is wrong: (the text to replace, by what, the line, the message)
    "unknown key at the top": ('name = "small"', 'nome = "small"', 1, "the file has the unknown key 'nome'; did you "
        "mean 'name'? known: name, materials, segments, sensor"),
    "unknown key of a material": ("emission", "emision", 4, "material 'lamp' has the unknown key 'emision'; did you "
        "mean 'emission'? known: emission, lambert, glossy, exponent, mirror"),
    "unknown key of a segment": ("end =", "ende =", 13, "a segment has the unknown key 'ende'; did you mean 'end'? "),
    "unknown key of a polyline": ("points =", "point =", 18, "a segment has the unknown key 'point'; did you mean "
        "'points'? "),
    "unknown key of a sensor": ("position", "positon", 22, "the pinhole sensor has the unknown key 'positon'; did you "
        "mean 'position'? known: kind, position, direction, half_angle, pixels"),
    "key of the other sensor": (PINHOLE, f"{WALL}half_angle = 1", 23, "the wall sensor has the unknown key "
        "'half_angle'; known: kind, segment, pixels"),
    "number in quotes": ("emission = 2", 'emission = "2"', 4, "material 'lamp': emission must be a number, not '2'"),
    "true for a number": ("emission = 2", "emission = true", 4, "material 'lamp': emission must be a number, not True"),
    "fraction for a whole number": ("exponent = 30", "exponent = 30.5", 7, "material 'grey': exponent must be a whole "
        "number, not 30.5"),
    "three coordinates": ("[4, 0]", "[4, 0, 1]", 13, "a segment: end must be two numbers [x, y], not [4, 0, 1]"),
    "text for a point": ("[4, 0]", '"right"', 13, "a segment: end must be two numbers [x, y], not 'right'"),
    "one point": ("[[2, 2], [1, 2.5], [0, 2]]", "[[2, 2]]", 18, "a segment: points must be a list of two points "
        "[x, y] or more, not [[2, 2]]"),
    "text for a flag": ("[0, 2]]", '[0, 2]]\nclosed = "yes"', 19, "a segment: closed must be true or false, not 'yes'"),
    "number for a name": ('"floor"\n', "3\n", 10, "a segment: name must be text in quotes, not 3"),
    "a table, not tables": ('[[segments]]       # line 9\nname = "floor"\nmaterial = "grey"\nstart = [0, 0]\n'
        "end = [4, 0]\n\n[[segments]]       # line 15", "[segments]", 9, "the file: segments must be tables "
        "[[segments]], in double brackets, not {"),
    "a material that is no table": ("[materials.lamp]   # line 3\nemission = 2", "materials.lamp = 2", 3, "material "
        "'lamp' must be a table, not 2"),
    "an enormous number": ("emission = 2", f"emission = 1{'0' * 400}", 4, "material 'lamp': emission must be a number"),
    "no name": ('name = "small"', "", 1, "the file lacks 'name': add name = ..., text in quotes"),
    "no sensor": (GOOD[GOOD.index("[sensor]") :], "", 1, "the file lacks 'sensor': add sensor = ..., a table [sensor]"),
    "no material": ('material = "grey"', "", 9, "a segment lacks 'material': add material = ..., text in quotes"),
    "no end": ("end = [4, 0]", "", 9, "a segment lacks 'end': add end = ..., two numbers [x, y]"),
    "no place": ("points = [[2, 2], [1, 2.5], [0, 2]]", "", 15, "a segment has no place: add start = [x, y] and "
        "end = [x, y], or points = [[x, y], ...]"),
    "two places": ("points", "start = [9, 9]\npoints", 15, "a segment has both points and start or end; keep one"),
    "closed without points": ("end = [4, 0]", "end = [4, 0]\nclosed = true", 14, "a segment: only a polyline is "
        "closed; give it points, or remove closed"),
    "closed with two points": (", [0, 2]]", "]\nclosed = true", 18, "a segment: a closed polyline has three points at "
        "least, not 2"),
    "no kind": ('kind = "pinhole"', "", 20, "the sensor lacks 'kind': add kind = \"pinhole\" or kind = \"wall\""),
    "unknown kind": ('"pinhole"', '"pinhola"', 21, "there is no sensor of the kind 'pinhola'; did you mean 'pinhole'? "
        "known: pinhole, wall"),
    "no position": ("position = [3.5, 1.5]", "", 20, "the pinhole sensor lacks 'position': add position = ..., two "
        "numbers [x, y]"),
    "unknown material": ('"grey"', '"gray"', 11, "there is no material 'gray'; did you mean 'grey'? known: lamp, grey"),
    "negative emission": ("emission = 2", "emission = -2", 4, "material 'lamp': emission must be finite and not "
        "negative: -2.0"),
    "no number": ("emission = 2", "emission = nan", 4, "material 'lamp': emission must be finite and not negative"),
    "exponent of 0": ("exponent = 30", "exponent = 0", 7, "material 'grey': exponent must be a whole number from 1"),
    "reflectance over 1": ("exponent = 30", "mirror = 0.7", 5, "material 'grey': the reflectances lambert + glossy + "
        "mirror must sum to 1 at most, not 1.1"),
    "degrees": ("[-1, -0.5]", "[-1, -0.5]\nhalf_angle = 35", 24, "the pinhole sensor: half_angle is in radians, over 0 "
        "and under 1.57, not 35"),
    "no direction": ("[-1, -0.5]", "[0, 0]", 23, "the pinhole sensor: direction must be finite and not zero"),
    "no pixels": ("[-1, -0.5]", "[-1, -0.5]\npixels = 0", 24, "the pinhole sensor: pixels must be a whole number, 1"),
    "no emitter": ("emission = 2", "emission = 0", 9, "no segment emits; give one a material with emission > 0"),
    "no segments": (GOOD[GOOD.index("[[segments]]") : GOOD.index("[sensor]")], "", 1, "the file lacks 'segments'"),
    "zero length": ("[4, 0]", "[0, 0]", 9, "segment 0 (floor) has no length: it runs from (0.0, 0.0) to (0.0, 0.0)"),
    "zero length in a polyline": ("[1, 2.5]", "[0, 2]", 15, "segment 2 (cover-2) has no length"),
    "infinite end": ("[4, 0]", "[inf, 0]", 9, "segment 0 (floor) has an end that is not finite"),
    "crossing segments": ("[4, 0]", "[2, 4]", 9, "segment 0 (floor) and segment 1 (cover-1) cross or overlap at (1.2, "
        "2.4); split them there, or move one"),
    "a name taken twice": ('"floor"', '"cover-1"', 15, "the name cover-1 is taken twice"),
    "sensor in a wall": ("[3.5, 1.5]", "[3.5, 0]", 20, "the pinhole at (3.5, 0.0) stands in segment 0 (floor); move"),
    "unknown sensor segment": (PINHOLE, WALL.replace("floor", "cover"), 20, "the sensor lies along 'cover', which is "
        "no segment; known: floor, cover-1, cover-2"),
    "not TOML": ("emission = 2", "emission 2", 4, "is not TOML: Expected '=' after a key in a key/value pair"),
    "not TOML at the end": ("[-1, -0.5]\n", '["', 23, "is not TOML: "),
    "a key given twice": ("emission = 2", "emission = 2\nemission = 3", 5, "is not TOML: Cannot overwrite a value"),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_one_line_says_where_and_what(tmp_path, what):
    old, new, line, message = WRONG[what]
    assert old in GOOD
    path = given(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(ValueError, match="^" + re.escape(f"{path}:{line}: {message}")) as error:
        read(path)
    assert "\n" not in str(error.value)
    assert type(error.value) is ValueError


def test_files_that_can_not_be_read_are_named(tmp_path):
    missing = tmp_path / "missing.toml"
    with pytest.raises(ValueError, match=f"^{re.escape(str(missing))}: there is no such file; give the path"):
        read(missing)
    with pytest.raises(ValueError, match=f"^{re.escape(str(tmp_path))}: can not be read: Is a directory"):
        read(tmp_path)
    with pytest.raises(ValueError, match=r"is not text in UTF-8 \(byte 8\)"):
        read(given(tmp_path, b'name = "\xff"'))
    with pytest.raises(ValueError, match=r"scene\.toml:1: the file lacks 'name'"):
        read(given(tmp_path, ""))


def test_a_name_that_looks_like_a_message_does_not_mislead(tmp_path):
    text = GOOD.replace('"small"', '"segment 2: the sensor"').replace("[3.5, 1.5]", "[3.5, 0]")
    with pytest.raises(ValueError, match=r"scene\.toml:20: the pinhole at \(3.5, 0.0\) stands in segment 0"):
        read(given(tmp_path, text))


# --- lines ----------------------------------------------------------------------------------------------------------


def test_the_line_is_found_whatever_the_text_holds():
    text = "\n".join(
        [
            "# [table] key = 1",
            'text = """',
            "[table]",
            'key = 0"""',
            "",
            "[table]  # key",
            "'key' = [1,",
            "  # key",
            "  2]",
            "a.b.c = 1",
            "[[list]]",
            "[[ list ]]",
            "inner = { x = 1, y = [2] }",
            "",
        ]
    )
    places = {
        (): 1, ("text",): 2, ("table",): 6, ("table", "key"): 7, ("table", "key", 1): 7, ("table", "a", "b", "c"): 10,
        ("list",): 11, ("list", 0): 11, ("list", 1): 12, ("list", 1, "inner", "y", 0): 13,
    }  # fmt: skip
    assert {keys: line_of(text, keys) for keys in places} == places
