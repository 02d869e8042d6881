# docs/examples/wave.tracks.json: pelvis and right wrist go in zigzag, 6 s of 20 frames.
import json

zigzag = lambda s: abs((s + 0.25) % 1 - 0.5) * 4 - 1  # 0 at 0, 1, 2, ...; between -1 and 1
pelvis, wrist = [], []
for frame in range(120):
    t = frame / 20
    x, z = 0.25 * zigzag(t / 3), 0.9 * t - 0.4 * min(t, 1)
    pelvis.append([round(x, 4), 0.92, round(z, 4)])
    wrist.append([round(x - 0.3 + 0.12 * zigzag(t), 4), round(1.15 + 0.2 * zigzag(t), 4), round(z + 0.3, 4)])
tracks = [
    {"joint": "pelvis", "frame": 0, "axes": "xz", "positions": pelvis},
    {"joint": "right_wrist", "frame": 20, "positions": wrist[20:]},
]
print(json.dumps({"tracks": tracks}))
