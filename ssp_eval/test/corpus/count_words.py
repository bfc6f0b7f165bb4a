"""Writes extract/llm/support.yaml anew, from the development texts.

Usage: python ssp_eval/test/corpus/count_words.py, in a shell of `eval "$(./ssp env)"`.
"""

from __future__ import annotations

from pathlib import Path

from ssp_eval.extract.llm.support import FILE, count, written
from ssp_eval.extract.measure import load_corpus

if __name__ == "__main__":
    corpus = load_corpus(Path(__file__).with_name("development.jsonl"))
    FILE.write_text(written(count((one.text, one.slots) for one in corpus)), encoding="utf-8")
