"""Findings of a diagnosis in the Python interface: those of a diagnosis of this process, and of one read from disk."""

from __future__ import annotations

from typing import TYPE_CHECKING

from seatrial.api.messages import in_python

if TYPE_CHECKING:
    from seatrial.ident.results import DiagnosisResult


class DiagnosisFindings:
    """Findings of a diagnosis: the effects that a model lacks, how certain they are, and what the data could show.

    Attributes
    ----------
    result : DiagnosisResult
        Content of result.json.
    """

    result: DiagnosisResult

    @property
    def effects(self) -> dict[str, str]:
        """Attribution of each effect that was added to the model, by name of the effect.

        It is ``identified`` (no competing model explains the data as well), ``ambiguous`` (a competing model is nearly
        as good, or a part remains unexplained) or ``nonparametric`` (a curve without a name). Empty without effects.
        """
        return {e.name: e.attribution for e in self.result.effects}

    @property
    def probabilities(self) -> dict[str, float]:
        """Share of names with the same attribution that were right on simulated boats, by name of the effect.

        The effects of these boats are known. The share is that of the attribution, and no probability for this boat.
        Curves without a name, and effects of thruster models, have no entry. The dictionary is empty without effects.
        """
        return {e.name: e.probability for e in self.result.effects if e.probability is not None}

    @property
    def detectable(self) -> dict[str, dict[str, float]]:
        """Smallest size that the data would have shown with a probability of 80 %, by effect and parameter.

        The effects are those of the catalogue that the model lacks. Sizes are in the units of the result. An effect
        that the estimated parameters explain at any size has an empty dictionary.
        """
        return {e.name: {p.name: p.size for p in e.sizes} for e in self.result.detectable}

    @property
    def recommended_experiment(self) -> str | None:
        """Experiments that would show which effect is missing, as sentences, with a call of `design` if one helps.

        They are for ambiguous effects, effects with competing ones and curves. Without an added effect they are for the
        best effect of each round. None if no experiment is recommended; `no_experiment` has the reason. If the
        diagnosed model was no file, the call names ``model.toml``: give the diagnosis itself, or save it and give the
        path of this file.
        """
        advice = self.result.recommended_experiment
        return None if advice is None else in_python(advice)

    @property
    def no_experiment(self) -> str:
        """Reason why no experiment is recommended, such as an effect without competing ones; empty if there is one."""
        return in_python(self.result.no_experiment)
