"""The benchmark: error against run time, silint and Embree QMC side by side in one run.

What is compared
----------------
Ambient occlusion at points spread uniformly over the mesh's area, lifted off it as far as Embree needs
(`silint.reference.embree_points`). Both sides get the same points and the same vertices, rounded to
float32, on the same number of threads. Every setting runs once per round, silint and Embree in turns, and
the median of the rounds counts. What is done once (hierarchies, tables, Sobol sets, compilation) is done
before, and hierarchies and tables are listed.

Time that a setting may take is limited (`seconds`): where all points would take longer, the first few of
them are timed, 256 at least; their order is random.

The truth
---------
RMSE needs a reference several times better than the best setting, and Embree's own error falls too slowly
to be one for silint at 512 lines. The reference is silint itself at 1024 lines, averaged over independent
random rotations of the whole scene: ambient occlusion does not change when everything turns, but every
line does, so the spread of the rotations is an honest standard error. It is reported, and an RMSE is
only given as a number if it is at least four times as large. Whether the reference is right, beyond being
precise, is for Embree to judge: the report compares the two point by point, in units of their joint
standard error, and lists each point beyond 5 of them.

The report (`run_bench`'s value, and the file of ``silint bench --json``)
--------------------------------------------------------------------------
schema : "silint-bench/1"
silint, numpy, numba, embreex : versions
machine : {processor, threads, threading_layer (of numba), load_average (before; null where unknown)}
options : {points, isolines, rays, weighting, seed, repeats, seconds, error_points}
scenes : list of
    name, n_faces, n_vertices
    build_seconds : {silint, embree}
    reference : {isolines, rotations, standard_error}        root mean square over the points
    check : reference against Embree
        {rays, scrambles, points, mean_difference, mean_difference_error,
         rms_sigma, max_sigma, p_value, beyond_5_sigma: [{point, normal, silint, embree, sigma}]}
        p_value : probability of max_sigma or more over all points, if only chance is at work (Sidak)
    rows : list, one for each setting
        {method: "silint" | "embree", setting, points, rounds, seconds, us_per_point, rmse, max_error,
         resolved, prepare_seconds (silint), rays_per_second, bare_rays_per_second (embree)}
        setting : isolines or rays a point; seconds : median over rounds, for `points` points
        rmse, max_error : over error_points; resolved : rmse >= 4 standard errors of the reference
        bare_rays_per_second : the same rays, made beforehand, through Embree's `run` alone
    equal_error : list of {rmse, silint, embree, speedup}
        silint, embree : {us_per_point, bound}; speedup : {value, bound}; log-log interpolation
        bound : "" exact; "<" the cheapest setting is better already; ">" no setting is as good;
        a speedup is null where the bounds decide nothing
"""

from silint.bench.command import bench_command
from silint.bench.measure import run_bench
from silint.bench.report import plot, print_tables

__all__ = ["bench_command", "plot", "print_tables", "run_bench"]
