"""The benchmark: error against run time, silint and Embree QMC side by side in one run.

What is compared
----------------
Ambient occlusion, irradiance from an environment, or transfer in spherical harmonics, at points spread
uniformly over the mesh's area or at its vertices, lifted off it as far as Embree needs
(`silint.reference.embree_points`). Embree follows the weight (cosine or uniform), and for irradiance combines
rays of the cosine with as many towards the bright parts of the map (`EmbreeQMC.irradiance`). Both sides get
the same points and the same vertices, rounded to float32, on the same number of threads; Embree may be timed
on fewer of the points (its time a point does not depend on their number). Every setting runs once per round,
silint and Embree in turns, and the median of the rounds counts. What is done once (hierarchies, tables, Sobol
sets, compilation) is done before, and hierarchies and tables are listed.

Errors of irradiance are relative, channel by channel: to the reference's mean of that channel over the
points. Where one number is asked for, it is the worst channel's. Those of harmonics are over points and
coefficients.

Time that a setting may take is limited (`seconds`): where all points would take longer, some are timed. Of
silint's, which share work with their neighbours, runs of 128 neighbours out of all points, spread over the
mesh; of Embree's the first few, in random order or spread over the mesh's vertices. The points whose errors
count are the first of these, and asked for on their own: a value does not depend on its company. The first
of silint's methods gets half of the time, and what cheap settings leave goes to expensive ones. A setting is
left out where already the cheaper one before takes more than what is left of its method's time, and so are
methods that this silint does not have.

The truth
---------
RMSE needs a reference several times better than the best setting, and Embree's own error falls too slowly
to be one for silint at 512 lines. The reference is silint itself at 1024 lines (or as many as a `goal` for
its standard error takes), averaged over independent random rotations of the whole scene: ambient occlusion
does not change when everything turns, irradiance does not when the light turns along, and harmonics can be
turned back; but every line changes, so the spread of the rotations is an honest standard error. It is
reported, and an RMSE is only given as a number if it is at least four times as large.
Whether the reference is right, beyond being precise, is for Embree to judge: the report compares the two
point by point, in units of their joint standard error, and lists each point beyond 5 of them. Under a small
sun, which few isolines see, Embree's many rays towards it are the surer of the two: where their standard
error is smaller they are the reference, and silint the judge. (The rays that are timed are others.)
References can be kept in a folder, under a hash of mesh, points and options.

The report (`run_bench`'s value, and the file of ``silint bench --json``)
--------------------------------------------------------------------------
A number that may be known by a bound only is {value, bound}: bound "" exact; "<" less; ">" more. Times are
microseconds a point.

schema : "silint-bench/4"
silint, numpy, numba, embreex : versions
machine : {processor, threads, threading_layer (of numba), load_average (before; null where unknown)}
options : {methods, points, embree_points, error_points, sites, isolines, rays, weighting, quantity,
           environment, max_degree, seed, repeats, seconds, goal, reference_method}
    quantity : "ao", "irradiance" or "sh"
    environment : name of the map, of irradiance; else null
    max_degree : of sh
scenes : list of
    name, n_faces, n_vertices, points (there are), memory (bytes of silint's parts)
    build_seconds : {method: ..., "embree": ...}             silint's with what its first query builds
    pays_after : {method: points {value, bound}, or "never", or null where bounds decide nothing}
        build_seconds over the time saved a point against Embree at RMSE 1e-3
    reference : {by, isolines, rotations, standard_error, unit}  root mean square over the points
        by : "silint" or "embree", whichever has the smaller standard error; isolines and rotations are
            silint's, the rays stand in check
        unit : of all errors below: 1, or for irradiance the reference's means of red, green and blue
    check : silint's reference against Embree
        {rays, scrambles, points, mean_difference, mean_difference_error,
         rms_sigma, max_sigma, p_value, beyond_5_sigma: [{point, normal, silint, embree, sigma}]}
        p_value : probability of max_sigma or more over all numbers, if only chance is at work (Sidak)
        beyond_5_sigma : with component, the channel or coefficient, where a value is more than a number
    rows : list, one for each setting
        {method, setting, points, rounds, seconds, us_per_point, rmse, max_error, resolved,
         prepare_seconds, diagnostics (silint), rays_per_second, bare_rays_per_second (embree)}
        method : one of silint's, or "embree"
        setting : isolines (of harmonics, as many as their degree needs: see diagnostics) or rays a point
            (samples: those of the light under the horizon make no ray);
            seconds : median over rounds, for `points` points
        rmse, max_error : over error_points; resolved : rmse >= 4 standard errors of the reference
        channels : of irradiance: list of {rmse, resolved} of red, green and blue; the largest is `rmse`
        diagnostics : of a run over as many points as they say
        bare_rays_per_second : the same rays, made beforehand, through Embree's `run` alone
    equal_error : list of {rmse, times, speedups, costs}
        times : {method: {value, bound}}, log-log interpolation; "<" the cheapest setting is better already;
            ">" no setting is as good
        speedups : {method of silint: Embree's time over its time}; null where the bounds decide nothing
        costs : {other method of silint: its time over the first method's}
    channels : of irradiance: as equal_error, for red, green and blue; else null
"""

from silint.bench.command import bench_command
from silint.bench.figures import plot, plot_scaling, scaling
from silint.bench.measure import run_bench
from silint.bench.report import print_tables

__all__ = ["bench_command", "plot", "plot_scaling", "print_tables", "run_bench", "scaling"]
