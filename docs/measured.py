"""Tables of the docs from what scripts of `benchmarks` measured: coverage, assembly, the bench."""

from scipy import special

from benchmarks import bench_table
from benchmarks.tables import stored, table


def _percent(share, seeds, due=0.95):
    """A share of seeds; bold where what is due would be so far off in fewer than one case in a hundred."""
    hits = round(share * seeds)
    chance = min(special.bdtr(hits, seeds, due), special.bdtrc(hits - 1, seeds, due))
    return f"**{100 * share:.1f}**" if chance < 0.005 else f"{100 * share:.1f}"


def coverage_rare():
    rows = [
        (
            name,
            f"{f['exact']:.2g}",
            f["seeds"],
            *(_percent(f[key], f["seeds"]) for key in ("held", "second held")),
            f"{f['mean over exact']:.3f}",
            f"{f['worst over exact']:.2f}",
            f"{100 * f['relative error']:.0f}",
            f"{100 * f['disagree']:.1f}",
            f"{f['evaluations'] - f['samples']:,}",
        )
        for name, f in stored("coverage")["rare"].items()
    ]
    heads = ["failures", "probability", "seeds", "held, %", "second held, %", "mean / exact", "worst / exact"]
    return table([*heads, "error, %", "disagree, %", "units next to `samples`"], rows)


def coverage_intervals():
    kept = stored("coverage")["intervals"]
    due = {"yield, lower end": 0.975}
    names = list(dict.fromkeys(name for found in kept.values() for name in found if name != "seeds"))
    rows = [
        (law, *(_percent(found[n], found["seeds"], due.get(n, 0.95)) if n in found else "-" for n in names))
        for law, found in kept.items()
    ]
    return table(["distribution, method", *names], rows)


def assembly_gauge():
    kept = stored("assembly")["gauge"]
    names = ["promised", "came true", "error of the difference", "unshrunk promise"]
    rows = [[f"{sd:g}", *(f"{100 * kept[name][k]:.1f} %" for name in names)] for k, sd in enumerate(kept["sd"])]
    headers = [
        "measurement sd",
        "promised",
        "came true",
        "standard error of the difference",
        "promised without population",
    ]
    return table(headers, rows)


def assembly_levers():
    kept = stored("assembly")["levers"]
    rows = [
        [
            name,
            f"{100 * share:.0f} % ± {100 * kept['standard error'][name]:.0f}",
            f"{kept['mean, arcsec'][name]:.2f} arcsec",
        ]
        for name, share in kept["good units"].items()
    ]
    return table(["chosen", f"units within {kept['limit, arcsec']:.1f} arcsec", "mean peak to peak"], rows)


def bench():
    rows = bench_table.table(stored("bench_table"))
    return table(rows[0], [[row[0].replace("_", " "), *row[1:]] for row in rows[1:]])


def end_of_line():
    kept = stored("end_of_line")
    held = [(name.replace("_", " "), f"{100 * share:.1f} %") for name, share in kept["held"].items()]
    held.append(("all", f"{100 * kept['held in all']:.1f} %"))
    found = [
        (f"{size} sigma" if size != "0" else "none", f"{100 * share:.1f} %", f"{100 * kept['due'][size]:.1f} %")
        for size, share in kept["alarms"].items()
    ]
    return "\n".join(
        [
            table(["intervals of 95 % that hold the truth", f"of {kept['units']:,} units"], held),
            table(["one journal off by", "called broken", "due"], found),
        ]
    )
