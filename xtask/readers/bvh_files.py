"""Positions of the joints of two BVH files as bvhio reads them: `bvh_files.py FOLDER` writes FOLDER/bvhio.json."""

import json
import pathlib
import sys
from importlib.metadata import version

import bvhio


def positions(path, names, frames):
    """[frame][joint][x, y, z], metres; the files are in centimetres."""
    root = bvhio.readAsHierarchy(str(path))
    joints = {joint.Name: joint for joint, _, _ in root.layout()}

    def place(name):
        return [round(value / 100.0, 5) for value in joints[name].PositionWorld]

    def pose(frame):
        root.loadPose(frame)
        return [place(name) for name in names]

    return [pose(frame) for frame in range(frames)]


folder = pathlib.Path(sys.argv[1])
about = json.loads((folder / "about.json").read_text())
read = {
    "reader": f"bvhio {version('bvhio')}",
    **{name: positions(folder / name, about["bvh_names"], about["frames"]) for name in ("rigid.bvh", "positions.bvh")},
}
(folder / "bvhio.json").write_text(json.dumps(read))
