"""Experiments in lock-step: training, evaluation, studies."""
