"""Nothing of a library on the terminal: each command runs twice, the second time with kept programs."""

import os
import re
import subprocess
import sys

from cli_study import GOOD

# Lost motion only, with a limit that no unit comes near: every yield is 1, which a logarithmic axis cannot show.
FLAT = re.sub(r"\[requirement\.(transmission_error|misfit)\](?s:.*?)\n\n", "", GOOD)
FLAT = FLAT.replace('output_torque = "412 N m" # assumed: rated torque\nangles = 64 ', "# ")
FLAT = FLAT.replace('"-1 arcmin"', '"-60 arcmin"').replace('"1 arcmin"\ntarget', '"60 arcmin"\ntarget')
FLAT = FLAT.replace("samples = 16384", "samples = 1024").replace("certificate_samples = 1_000_000", "#")
FLAT = re.sub(r"\[cost\.(crank|disc|carrier)_(?s:.*?)\n\n", "", FLAT)
FLAT += "certificate_samples = 4096\n"
CURVE = "angle [deg],error [arcsec]\n" + "".join(f"{k},{10 * (k % 9)}\n" for k in range(360))
PARTS = "kind,id,disc_runout [um],pin_radius [um]\n" + "".join(
    f"flanks,f{k},{3 * k},\npins,p{k},,{k / 2 - 1}\n" for k in range(4)
)
COMMANDS = {
    "check": ["flat.toml"],
    "montecarlo": ["flat.toml", "--samples", "3000"],
    "allocate": ["flat.toml", "--fresh"],
    "compensate": ["flat.toml", "curve.csv"],
    "assemble": ["flat.toml", "parts.csv"],
}
RUN = """
import sys
import jax
from rvjax import cli
hits = []
jax.monitoring.register_event_listener(lambda event, **_: hits.append(event) if "cache_hits" in event else None)
for run in (1, 2):
    for command, arguments in {commands!r}.items():
        print("begin", run, command, file=sys.stderr, flush=True)
        code = cli.main([command, *arguments, *(["--quiet"] if command != "check" else [])])
        assert code == 0, (command, code)
    assert run == 1 or len(hits) > 5, hits
    hits.clear()
    jax.clear_caches()
"""


def test_nothing_of_a_library_reaches_the_terminal(tmp_path):
    """JAX leaves "1" in the environment of whatever a notebook or script starts, and here it is loaded before."""
    for name, text in {"flat.toml": FLAT, "curve.csv": CURVE, "parts.csv": PARTS}.items():
        (tmp_path / name).write_text(text)
    own = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "kept"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "TF_CPP_MIN_LOG_LEVEL": "1",
    }
    done = subprocess.run(
        [sys.executable, "-c", RUN.format(commands=COMMANDS)],
        cwd=tmp_path, env=os.environ | own, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    said = done.stderr.splitlines()
    assert sum(line.startswith("begin ") for line in said) == 2 * len(COMMANDS)
    assert [line for line in said if not line.startswith(("begin ", "rvjax: warning: "))] == []
