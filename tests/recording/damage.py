"""Damages recordings and reads them: `damage.py TRIALS SEED`.

Bit flips and truncations of a journal and of a packed file, each read in a forked process with
2 GiB of memory and 10 s. Prints one line of JSON with the outcomes of each kind: "error" (an
exception of substep), "identical" (all frames right), "prefix" (the first frames, all right),
"WRONG", or what happened instead.
"""

import collections
import functools
import json
import os
import random
import resource
import signal
import sys
import tempfile
from pathlib import Path

import numpy as np
import substep
import substep.recording.packed
from substep.export import pack_here

FRAMES = 4
TRIANGLES = [[0, 1, 2], [0, 2, 3]]
PARTS = {
    "dust": substep.Part("particles", {"velocity": "m/s"}),
    "sheet": substep.Part("mesh", {"tension": "N"}, TRIANGLES),
    "block": substep.Part("mesh", {}, tetrahedra=[[0, 1, 2, 3]]),
    "floor": substep.Part("mesh", {}, TRIANGLES, points=np.eye(4, 3)),
    "air": substep.Part("grid", {"smoke": "1"}, bounds=[(0, 0, 0), (1, 2, 3)], cell=1.0),
}
OUTCOMES = ("identical", "prefix", "error", "WRONG", "MemoryError", "other exception")


@functools.cache
def frame(k):
    rng = np.random.default_rng(k)
    n = 20 + k
    return {
        "dust": {"points": rng.random((n, 2)), "velocity": rng.random((n, 2))},
        "sheet": {"points": rng.random((4, 3)), "tension": rng.random(4)},
        "block": {"points": rng.random((4, 3))},
        "air": {"smoke": rng.random((1, 2, 3))},
    }


def record(path):
    recorder = substep.Recorder(path, parts=PARTS, scene="damage", parameters={"a": 1}, seed=5)
    for k in range(FRAMES):
        recorder.append(k / 24, frame(k))
    recorder._release()


def read(path, recover):
    with substep.Recording(path, recover=recover) as recording:
        same = (
            recording.scene == "damage"
            and recording.parameters == {"a": 1}
            and recording.seed == 5
            and list(recording.parts) == list(PARTS)
            and all(recording.parts[n].fields == PARTS[n].fields for n in PARTS)
            and all(
                np.array_equal(array, getattr(PARTS[n], key))
                for n in PARTS
                for key, array in recording.parts[n].constants().items()
            )
        )
        for k, (time, arrays) in enumerate(recording):
            wanted = {**frame(k), "floor": {"points": PARTS["floor"].points}} if k < FRAMES else {}
            same = same and time == k / 24 and arrays.keys() == wanted.keys()
            for part, name in ((p, n) for p in wanted for n in wanted[p]):
                same = same and arrays[part][name].tobytes() == wanted[part][name].tobytes()
        return "WRONG" if not same else "identical" if len(recording) == FRAMES else "prefix"


def outcome(path, recover):
    try:
        return read(path, recover)
    except substep.FormatError:
        return "error"
    except MemoryError:
        return "MemoryError"
    except BaseException:
        return "other exception"


def outcomes(victims, path, recover):
    """Outcome of each damaged file; a forked process reads on until one of them ends it."""
    done = 0
    while done < len(victims):
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))
            for data in victims[done:]:
                signal.alarm(10)
                Path(path).write_bytes(data)
                os.write(writer, bytes([OUTCOMES.index(outcome(path, recover))]))
            os._exit(0)
        os.close(writer)
        with open(reader, "rb") as file:
            for code in file.read():
                done += 1
                yield OUTCOMES[code]
        _, status = os.waitpid(child, 0)
        if status:
            done += 1
            yield f"ended with status {status}"


def damage(data, kind, trial, rng):
    if kind == "truncate":
        return data[: rng.randrange(len(data))]
    flipped = bytearray(data)
    for _ in range(1 + trial % 8):
        flipped[rng.randrange(len(flipped))] ^= 1 << rng.randrange(8)
    return bytes(flipped)


def main(trials, seed):
    rng = random.Random(seed)
    tally = {}
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder, "a.vtkhdf"))
        record(path)
        files = {"journal": Path(path + ".journal").read_bytes()}
        pack_here(path, None, False)
        files["packed"] = Path(path).read_bytes()
        victim = str(Path(folder, "victim"))
        for name, data in files.items():
            for kind in ("flip", "truncate"):
                for recover in (False, True):
                    victims = [damage(data, kind, trial, rng) for trial in range(trials // 2)]
                    victims = [damaged for damaged in victims if damaged != data]
                    counts = collections.Counter(outcomes(victims, victim, recover))
                    tally[f"{name} {kind}{' recover' if recover else ''}"] = counts
    print(json.dumps(tally))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
