"""Scoring of behaviour records against labels (METHOD 6), without ROS, images or numpy."""

from ssp_eval.score.cell import CellDetails, CellScore, score_cell
from ssp_eval.score.ivcs import ivcs, ivcs_terms, ivcs_weights
from ssp_eval.score.judge import STAGES, Judgement
from ssp_eval.score.thresholds import DEFAULT, Thresholds

__all__ = [
    "DEFAULT",
    "STAGES",
    "CellDetails",
    "CellScore",
    "Judgement",
    "Thresholds",
    "ivcs",
    "ivcs_terms",
    "ivcs_weights",
    "score_cell",
]
