"""Clusters of points, halved until each predicts what it holds back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.core import scattered
from silint.core.jit import KERNEL_LOCK
from silint.core.scattered import ANCHOR, CHECK, UNKNOWN
from silint.validation import InputError

__all__ = ["Progress", "Query", "Refinement"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Query = Callable[[FloatArray, FloatArray], FloatArray]
Progress = Callable[[int, int], None]

# Points of a cluster, at first and at least: smaller ones are computed whole.
_FIRST = 64
_LEAST = 3
# Anchors that a prediction looks at.
_NEAR = 24
# Of the reach of these: no point of a cluster is farther from its centre.
_COVERED = 0.5
# Held-back points have to be this much better than the tolerance: the others are no better than they.
_MARGIN = 0.5
# Of the points: with so many computed, halving clusters that still fail would spare less than it costs.
_MOST_SHARE = 0.4
# A pilot shows whether predicting pays: runs of so many clusters, computed whole; of all points so many, and
# so many at most.
_RUN, _PILOT, _PILOT_POINTS = 4, 1 / 48, 4096
# Fewer points are computed: there is nothing to spare.
_LEAST_POINTS = 512
# A cluster is spared where so many of its points are predicted, by measured shares of computed points.
_AT_ONCE = 5
# What predicting costs, in the seconds of `cost`: for each computed point, and for each point; and what a
# point costs that is computed without its neighbours, in points. Measured on textures.
_SECONDS_COMPUTED, _SECONDS, _ALONE = 30e-6, 1e-6, 1.3
# Points that are computed between two reports: fewer make worse tiles, and 3 % more work.
_CHUNK = 1 << 17
# Rounds, in the last of which clusters that still fail are computed whole.
_MOST_ROUNDS = 20


class _Clusters(NamedTuple):
    """Ranges of the points' order, a row each."""

    begin: IntArray
    end: IntArray
    centre: FloatArray
    """(c, 6) mean position and normal."""
    radius: FloatArray
    """How far from there the farthest point is."""
    check: IntArray
    """Row of the held-back point, -1 for none."""
    near: IntArray
    """(c, _NEAR) rows of anchors, -1 for none."""
    reach: FloatArray
    """How far the farthest of these is, in the tree of anchors; infinite if there are no more."""
    seen: IntArray
    """The round in which these were found."""
    error: FloatArray
    """Of the held-back point."""

    def take(self, rows: npt.NDArray[Any]) -> _Clusters:
        """Some of them, by numbers or by a mask."""
        fields: Any = (field[rows] for field in self)
        return _Clusters(*fields)


class Refinement:
    """The state of an interpolation; `run` brings it to its end.

    Parameters
    ----------
    query : callable
    x, n : (N, 3) float64
        Distinct points in an order that does not depend on the caller's, and unit normals.
    label : (N,) int64
        Surfaces.
    tolerance : float
    bounds : (float, float), optional
    progress : callable
    cost : callable, optional
        See `interpolate`.
    """

    def __init__(
        self,
        query: Query,
        x: FloatArray,
        n: FloatArray,
        label: IntArray,
        tolerance: float,
        bounds: tuple[float, float] | None,
        progress: Progress,
        cost: Callable[[], float] | None = None,
    ) -> None:
        self.cost = cost
        self.query, self.tolerance, self.bounds, self.progress = query, tolerance, bounds, progress
        self.x, self.n, self.label = x, n, label
        self.order = np.argsort(label, kind="stable")
        self.state = np.zeros(len(x), np.uint8)
        self.became_anchor = np.full(len(x), -1)  # in which round
        self.value: FloatArray = np.zeros((len(x), 1))
        self.shape: tuple[int, ...] = ()
        self.rounds = self._settled = 0
        self.held_back_error = 0.0
        size = float(np.ptp(x, axis=0).max()) if len(x) else 0.0
        # Surfaces are apart in the tree of anchors, and so are the two sides of a thin wall.
        self._apart = 4.0 * size
        self._normal_scale = 0.0

    def run(self) -> None:
        """Compute what has to be computed, and predict the rest."""
        if not len(self.x):
            return
        new = self._first_clusters()
        self._normal_scale = float(np.median(new.radius))
        if not self._pays(new):
            self._compute_rest(self.order[self.state[self.order] == UNKNOWN])
            return
        settled: list[_Clusters] = []
        while True:
            self.rounds += 1
            new, failed = self._judged(self._computed(new))
            if not failed.any():
                # All of them again, from all anchors that there are by now.
                new, failed = self._judged_again(_joined([*settled, new]))
                settled = []
                if not failed.any():
                    break
            settled.append(new.take(~failed))
            new = new.take(failed)
            self._make_anchors(new.check, self.rounds + 1)
            share = np.count_nonzero(self.state) / len(self.state)
            last = self.rounds == _MOST_ROUNDS
            if share < _MOST_SHARE and not last:
                new = self._clusters(*self._halves(new.begin, new.end))
            else:
                rest, _ = self._unknown(new)
                self._make_anchors(rest, self.rounds + 1)
                self._compute(rest)
                new = new.take(np.zeros(0, np.int64))
            self._report(new)
            if last:
                # The others are as they were judged: their anchors stay those that they were judged with.
                new = _joined([*settled, new])
                break
        self._predict_rest(new)
        self.progress(len(self.x), len(self.x))

    def _pays(self, clusters: _Clusters) -> bool:
        """Whether predicting spares more than it costs, as some runs of clusters that are computed show.

        Of each run every other point is predicted from the rest, as well as will ever be of use: on scans
        a half of them fails, and hardly a cluster is spared in the end.
        """
        if self.cost is None:
            return True
        n = len(self.x)
        if n < _LEAST_POINTS:
            return False
        size = _RUN * n / len(clusters.begin)
        runs = max(round(min(_PILOT * n, _PILOT_POINTS) / size), 2)
        first = ((np.arange(runs) + 0.5) * len(clusters.begin) / runs).astype(np.int64)
        chosen = np.unique((first[:, None] + np.arange(_RUN)).clip(max=len(clusters.begin) - 1))
        pilot = clusters.take(chosen)
        rows, of_row = self._members(pilot)
        self._compute(rows)
        odd = np.arange(len(rows)) % 2 == 1
        self.state[rows[~odd]] = ANCHOR
        error = self._errors(rows[odd], of_row[odd], self._with_nearest(pilot).near)
        self._make_anchors(rows, 1)
        predicted = np.count_nonzero(error <= _MARGIN * self.tolerance) / max(len(error), 1)
        share = 1.0 - predicted**_AT_ONCE
        plain = self.cost()
        return bool(share * (_ALONE * plain + _SECONDS_COMPUTED) + _SECONDS < plain)

    def _compute_rest(self, rows: IntArray) -> None:
        """Compute these, which are all that are left, as anchors."""
        n = len(self.x)
        for start in range(0, len(rows), _CHUNK):
            chunk = rows[start : start + _CHUNK]
            self._compute(chunk)
            self._make_anchors(chunk, self.rounds)
            self.progress(n - len(rows) + start + len(chunk), n)
        self.progress(n, n)

    def _first_clusters(self) -> _Clusters:
        """Surfaces, halved until they are small."""
        _, counts = np.unique(self.label, return_counts=True)
        end = np.cumsum(counts)
        small = []
        begin, end = end - counts, end
        while len(begin):
            large = end - begin > _FIRST
            small.append((begin[~large], end[~large]))
            begin, end = self._halves(begin[large], end[large])
        begins, ends = zip(*small, strict=True) if small else ([end], [end])
        return self._clusters(np.sort(np.concatenate(begins)), np.sort(np.concatenate(ends)))

    def _clusters(self, begin: IntArray, end: IntArray) -> _Clusters:
        c = len(begin)
        centre, radius = np.empty((c, 6)), np.empty(c)
        scattered.centres(self.x, self.n, self.order, begin, end, centre, radius)
        near, none = np.full((c, _NEAR), -1), np.full(c, -1)
        return _Clusters(begin, end, centre, radius, none, near, np.full(c, np.inf), none, np.zeros(c))

    def _halves(self, begin: IntArray, end: IntArray) -> tuple[IntArray, IntArray]:
        middle = np.empty_like(begin)
        with KERNEL_LOCK:
            scattered.halve(self.x, self.n, self.order, begin, end, middle)
        return np.stack([begin, middle], axis=1).ravel(), np.stack([middle, end], axis=1).ravel()

    def _computed(self, new: _Clusters) -> _Clusters:
        """The same with anchors, the anchors near them and a point held back, all of them computed."""
        if not len(new.begin):
            return new
        rows, of_row = self._members(new)
        size = new.end - new.begin
        whole = rows[(size[of_row] <= _LEAST) & (self.state[rows] == UNKNOWN)]
        anchors = np.bincount(of_row[self.state[rows] == ANCHOR], minlength=len(size))
        bare = (anchors == 0) & (size > _LEAST)
        central = np.empty(np.count_nonzero(bare), np.int64)
        scattered.central_rows(self.x, self.order, new.begin[bare], new.end[bare], new.centre[bare], central)
        fresh = np.concatenate([whole, central])
        self._make_anchors(fresh, self.rounds)
        new, check = self._with_nearest(new), np.empty(len(size), np.int64)
        scattered.remotest_rows(self.x, self.order, new.begin, new.end, self.state, new.near, check)
        held_back = check[check >= 0]
        self.state[held_back] = CHECK
        self._compute(np.concatenate([fresh, held_back]))
        return new._replace(check=check)

    def _judged(self, clusters: _Clusters) -> tuple[_Clusters, npt.NDArray[np.bool_]]:
        """The same with errors of held-back points, and which clusters predict too badly."""
        error = np.zeros(len(clusters.begin))
        tested = np.flatnonzero(clusters.check >= 0)
        error[tested] = self._errors(clusters.check[tested], tested, clusters.near)
        # Points beyond the anchors that are looked at may have others next to them.
        failed = (error > _MARGIN * self.tolerance) | (
            (clusters.check >= 0) & (clusters.radius > _COVERED * clusters.reach)
        )
        # Anchors are predicted from the others, too.
        rows, of_row = self._members(clusters)
        again = (self.state[rows] == ANCHOR) & (clusters.check[of_row] >= 0) & ~failed[of_row]
        rows, of_row = rows[again], of_row[again]
        failed[of_row[self._errors(rows, of_row, clusters.near) > self.tolerance]] = True
        return clusters._replace(error=error), failed

    def _judged_again(self, clusters: _Clusters) -> tuple[_Clusters, npt.NDArray[np.bool_]]:
        """The same with the anchors that are nearest now, and which of those that get new ones fail."""
        outdated = self._outdated(clusters)
        if not outdated.any():
            return clusters, outdated
        judged, fails = self._judged(self._with_nearest(clusters.take(outdated)))
        kept = clusters.take(~outdated)
        both, failed = _joined([kept, judged]), np.concatenate([np.zeros(len(kept.begin), bool), fails])
        # Neighbours after each other, as the points in their order, make looking up twice as fast.
        by_place = np.argsort(both.begin)
        return both.take(by_place), failed[by_place]

    def _errors(self, rows: IntArray, of_row: IntArray, near: IntArray) -> FloatArray:
        """Of predictions of computed rows, in their worst component; infinite where there is none."""
        off = np.abs(self._predicted(rows, of_row, near) - self.value[rows]).max(axis=1, initial=0.0)
        return np.where(np.isnan(off), np.inf, off)

    def _predicted(self, rows: IntArray, of_row: IntArray, near: IntArray) -> FloatArray:
        out = np.empty((len(rows), self.value.shape[1]))
        with KERNEL_LOCK:
            scattered.predict(self.x, self.n, self.label, rows, of_row, near, self.value, out)
        return out if self.bounds is None else out.clip(*self.bounds)

    def _with_nearest(self, clusters: _Clusters) -> _Clusters:
        """The same with the anchors that are nearest now, on their surface and their side of it."""
        anchors = self.order[self.state[self.order] == ANCHOR]
        k = min(_NEAR, len(anchors))
        distance, found = self._look_up(anchors, clusters, k)
        near, reach = np.full((len(clusters.begin), _NEAR), -1), np.full(len(clusters.begin), np.inf)
        near[:, :k] = anchors[found.reshape(-1, k)]
        if k == _NEAR:
            reach = distance[:, -1]
        return clusters._replace(near=near, reach=reach, seen=np.full(len(reach), self.rounds))

    def _outdated(self, clusters: _Clusters) -> npt.NDArray[np.bool_]:
        """Whether there are anchors within a cluster's reach that it has not seen."""
        out = np.zeros(len(clusters.begin), bool)
        for seen in np.unique(clusters.seen):
            fresh = self.order[self.became_anchor[self.order] > seen]
            rows = np.flatnonzero(clusters.seen == seen)
            if len(fresh):
                distance, _ = self._look_up(fresh, clusters.take(rows), 1)
                out[rows] = distance < clusters.reach[rows]
        return out

    def _look_up(self, anchors: IntArray, clusters: _Clusters, k: int) -> tuple[FloatArray, IntArray]:
        """Distances and numbers of the k anchors that are nearest to the centres of clusters."""
        from numba import get_num_threads
        from scipy.spatial import cKDTree

        label = self.label[self.order[clusters.begin]]
        tree = cKDTree(self._in_tree(self.x[anchors], self.n[anchors], self.label[anchors]))
        at = self._in_tree(clusters.centre[:, :3], clusters.centre[:, 3:], label)
        distance, found = tree.query(at, k, workers=get_num_threads())
        return distance, found

    def _in_tree(self, x: FloatArray, n: FloatArray, label: IntArray) -> FloatArray:
        shifted = x.copy()
        shifted[:, 0] += self._apart * label
        return np.concatenate([shifted, self._normal_scale * n], axis=1)

    def _make_anchors(self, rows: IntArray, seen_from: int) -> None:
        """Anchors that clusters see whose nearest are looked up from that round on."""
        self.became_anchor[rows] = seen_from
        self.state[rows] = ANCHOR

    def _compute(self, rows: IntArray) -> None:
        """Ask the query for these rows."""
        if not len(rows):
            return
        found = np.asarray(self.query(self.x[rows], self.n[rows]), np.float64)
        if found.ndim not in (1, 2) or len(found) != len(rows):
            raise InputError(
                f"query returned shape {found.shape} for {len(rows)} points; expected (m,) or (m, C)"
            )
        if self.rounds <= 1 and not self.shape and found.ndim == 2:
            self.shape = found.shape[1:]
            self.value = np.zeros((len(self.x), *self.shape))
        self.value[rows] = found.reshape(len(rows), -1)

    def _members(self, clusters: _Clusters) -> tuple[IntArray, IntArray]:
        """All rows of clusters, and which cluster each is of."""
        size = clusters.end - clusters.begin
        of_row = np.repeat(np.arange(len(size)), size)
        start = np.cumsum(size) - size
        return self.order[np.arange(len(of_row)) + (clusters.begin - start)[of_row]], of_row

    def _unknown(self, clusters: _Clusters) -> tuple[IntArray, IntArray]:
        rows, of_row = self._members(clusters)
        unknown = self.state[rows] == UNKNOWN
        return rows[unknown], of_row[unknown]

    def _predict_rest(self, clusters: _Clusters) -> None:
        rows, of_row = self._unknown(clusters)
        predicted = self._predicted(rows, of_row, clusters.near)
        alone = np.isnan(predicted).any(axis=1)
        self.value[rows] = predicted
        self._make_anchors(rows[alone], self.rounds)
        self._compute(rows[alone])
        if (self.state == UNKNOWN).any():
            self.held_back_error = float(clusters.error.max())

    def _report(self, open_clusters: _Clusters) -> None:
        # Clusters that were settled may be opened again.
        n = len(self.x)
        self._settled = max(self._settled, n - len(self._unknown(open_clusters)[0]))
        self.progress(self._settled, n)


def _joined(parts: list[_Clusters]) -> _Clusters:
    return _Clusters(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
