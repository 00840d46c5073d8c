# SPDX-License-Identifier: MIT
"""Export a run's joint agent: `python -m hybrid_jax.export --run DIR --out policy.stablehlo`."""

from pathlib import Path

from hybrid_jax.runtime.progress import working
from hybrid_jax.runtime.terminal import answer, run_main


def main(run: Path, out: Path, quiet: bool = False, json: bool = False) -> int:
    """Write the policy of a run's joint agent as StableHLO, and a JSON file that describes it.

    Args:
        run: folder of a trained run.
        out: file to write; the description gets the same name with .json.
        quiet: print the answer only.
        json: print the answer as JSON.
    """
    from hybrid_jax.export.policies import export_policy
    from hybrid_jax.runs.run_folder import open_run

    with working("export", "lowering the policy", quiet):
        export_policy(open_run(run), out)
    files = [str(out), str(out.with_suffix(".json"))]
    answer(f"written to {' and '.join(files)}", {"files": files}, json)
    return 0


if __name__ == "__main__":
    run_main(main)
