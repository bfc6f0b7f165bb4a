"""How well an extractor does on texts with known slots: precision, recall, confusion, spans."""

from ssp_eval.extract.measure.corpus import Example, load_corpus
from ssp_eval.extract.measure.counts import Measure, measure
from ssp_eval.extract.measure.intervals import Share, wilson

__all__ = ["Example", "Measure", "Share", "load_corpus", "measure", "wilson"]
