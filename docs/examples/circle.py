# docs/examples/circle.tracks.json: the pelvis once round a circle to the left, the left wrist inside of it, 8 s of 20 frames.
import json
from math import cos, pi, sin

pelvis, wrist = [], []
for frame in range(160):
    turn = 2 * pi * frame / 159
    pelvis.append([round(1 - cos(turn), 4), 0.92, round(sin(turn), 4)])
    ahead = turn + 0.25
    wrist.append([round(1 - 0.7 * cos(ahead), 4), round(1.0 + 0.1 * sin(3 * turn), 4), round(0.7 * sin(ahead), 4)])
tracks = [
    {"joint": "pelvis", "frame": 0, "axes": "xz", "positions": pelvis},
    {"joint": "left_wrist", "frame": 0, "positions": wrist},
]
print(json.dumps({"tracks": tracks}))
