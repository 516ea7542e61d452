"""Two policies as one with `network: dual-set`: ``python -m benchmarks.join WHOLE PART OUT``.

WHOLE and PART are folders with the policy.safetensors and config.yaml of a policy with `network: set`. The new policy
is WHOLE with the actor of PART beside its own; their logits count half each. It is the start of a training that joins
them: ``uavaou train --from OUT``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from uavaou.algorithms.io.tensor_file import ArrayFile, write_arrays
from uavaou.files import read_text, write_text

BODY, HEAD = "policy.actor_body.", "policy.action_net."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    for name in ("whole", "part", "out"):
        parser.add_argument(name, type=Path)
    chosen = parser.parse_args()
    files = [ArrayFile(folder / "policy.safetensors") for folder in (chosen.whole, chosen.part)]
    chosen.out.mkdir(parents=True, exist_ok=True)
    text = {name: value for name, value in files[0].text.items() if name != "checksum"}
    write_arrays(chosen.out / "policy.safetensors", joined(*({n: f.read(n) for n in f.shapes} for f in files)), text)
    config = yaml.safe_load(read_text(chosen.whole / "config.yaml", 1_000_000))
    config["algorithm"]["network"] = "dual-set"
    del config["start"]
    write_text(chosen.out / "config.yaml", yaml.safe_dump(config, sort_keys=False))
    print(f"digest: {ArrayFile(chosen.out / 'policy.safetensors').digest('policy.')}")


def joined(
    whole: dict[str, NDArray[np.float32]], part: dict[str, NDArray[np.float32]]
) -> dict[str, NDArray[np.float32]]:
    """The arrays of the new policy."""
    arrays: dict[str, NDArray[np.float32]] = {}
    for name, array in whole.items():
        if name.startswith(BODY):
            rest = name.removeprefix(BODY)
            arrays |= {f"{BODY}whole.{rest}": array, f"{BODY}part.{rest}": part[name]}
        elif name.startswith(HEAD):
            both = array, part[name]  # the weights (5, size) lie side by side, the biases (5,) are added
            arrays[name] = (np.concatenate(both, axis=1) if array.ndim > 1 else np.add(*both)) * np.float32(0.5)
        else:
            arrays[name] = array
    return arrays


if __name__ == "__main__":
    main()
