"""Limbs of several physics, from the first recording to their motions.

`LimbTwin`'s physics "lumped" and the model grew up together, so what works on it may work on
nothing else. Its physics "continuum" shares none of its laws, and neither does an `OtherLimb`,
whose wires follow Liang and Rogers' cosine kinetics, with
heat that flows through three masses to a room by natural convection, a resistance that changes
with the phase, and thermocouples that lag twice; its body is one bending mode on a cubic
spring with a Maxwell element. Its numbers are ours, within what is published of such wires
and silicones. All are emulations, and not measurements of limbs.

Each limb is recorded by `excitations` alone, calibrated, and driven along three motions, in open
            run["time"] = time.process_time() - start
            (segment,) = limb.parameters.segments
            true = segment.bend_sensor.exact_bend_angle(driven.joint_state[: segment.links])
            truth = dataclasses.replace(driven, bend_angle=true[None])
            nearest = nearest_bend_angle(trajectory)
            distances = reference_distances(trajectory, [truth], nearest)
            errors = {
                "true from reference": distances.done,
                "plan": distances.planned,
                "limits leave": np.nan if distances.nearest is None else distances.nearest,
                "read from plan": tracking_errors(trajectory, [driven]).mean,
                "true from plan": tracking_errors(trajectory, [truth]).mean,
            }
            run |= {what: float(np.rad2deg(error)) for what, error in errors.items()}
            run["highest V"] = float(driven.measured_temperature.max())
            run["highest T"] = float(driven.wire_temperature.max())
    return {
        "seed": seed,
        "law": calibration.prediction.best.name,
        "bend error": np.rad2deg(record.bend_error),
        "temperature error": record.temperature_error,
        "runs": runs,
    }


def show(physics: str, limbs: list[dict]) -> None:
    print(f"{len(limbs)} limbs, physics {physics}")
    for limb in limbs:
        print(
            f"  {limb['seed']}: {limb['law']}, motions predicted to {limb['bend error']:.1f}° and "
            f"{limb['temperature error']:.1f} °C"
        )
    columns = ("true from reference", "plan", "limits leave", "read from plan", "true from plan")
    print(f"{'mean distance, °':<24}" + "".join(f"{column:>22}" for column in columns), end="")
    print(f"{'V':>8}{'T':>8}  highest, °C")
    runs = [run for limb in limbs for run in limb["runs"]]
    for motion, way in dict.fromkeys((run["motion"], run["way"]) for run in runs):
        these = [r for r in runs if (r["motion"], r["way"]) == (motion, way)]
        done = [run for run in these if "failure" not in run]
        for run in these:
            if "failure" in run:
                print(f"  {motion}, {way}: {run['failure']}")
        if done:
            means = [np.mean([run[column] for run in done]) for column in columns]
            print(f"{motion + ', ' + way:<24}" + "".join(f"{m:>22.2f}" for m in means), end="")
            print("".join(f"{max(r[f'highest {x}'] for r in done):>8.1f}" for x in "VT"))
    times = [r["time"] for r in runs if r["way"] == OPEN_LOOP and "time" in r]
    print(f"a motion in open loop takes {np.median(times):.1f} s of the processor (median)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--physics", choices=(OTHER, *SPECIMENS), default=OTHER, help="default %(default)s"
    )
    parser.add_argument("--limbs", type=int, default=6, help="default %(default)s")
    parser.add_argument("--first", type=int, default=0, help="number of the first limb")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default %(default)s)")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.limbs)
    taking = functools.partial(take, options.physics)
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        show(options.physics, pool.map(taking, seeds, chunksize=1))


if __name__ == "__main__":
    main()
