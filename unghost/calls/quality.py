"""Quality: the filter against people, and its channels against each other."""

from __future__ import annotations

from unghost.calls.base import Calls, dataset_path
from unghost.quality_results import Evaluation, Goal, Quality, Truth
from unghost.work_results import Run


class QualityCalls(Calls):
    """Methods on quality and on comparisons of channels."""

    def quality(
        self,
        dataset: str,
        *,
        target: Goal = "f1",
        recall: float | None = None,
        truth: Truth = "people",
    ) -> Quality:
        """The filter against what is true, and thresholds that would fit better.

        True is what people answered, or with `truth="instances"` what instance images
        show; they are measured by `evaluate`.
        Suggested are those of the best F1, or with `target="recall"` the highest that
        still have this `recall`.
        """
        params: dict[str, str | float] = {"target": target, "truth": truth}
        if recall is not None:
            params["recall"] = recall
        return self._get(Quality, dataset_path(dataset, "quality"), params)

    def evaluate(self, dataset: str) -> Run:
        """Measure every channel that the frames' files allow; no verdict changes.

        The run can be waited for; then `evaluations` has all channels.
        """
        return self._post(Run, dataset_path(dataset, "evaluations"))

    def evaluations(self, dataset: str, *, truth: Truth = "instances") -> Evaluation:
        """Precision, recall and F1 of every channel that was measured so far."""
        path = dataset_path(dataset, "evaluations")
        return self._get(Evaluation, path, {"truth": truth})
