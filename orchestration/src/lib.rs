//! Process sets: command line, supervisor, evaluation.
