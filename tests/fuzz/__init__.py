"""Coverage-guided fuzzing of everything that reads bytes of clients; `make fuzz`, results in docs/fuzz.md.

A target reads one input with one parser. Only the documented errors of that parser may leave it, within the bounds of
:mod:`tests.fuzz.bounds`. The corpus of each target is kept in ``corpus/``, and ``test_corpus.py`` replays it.
"""
