"""Subcommands of `soil-env` as functions of their arguments that return the exit status."""

from soil_env.cli import main


def train(arguments):
    return main(["train", *map(str, arguments)])


def evaluate(arguments):
    return main(["evaluate", *map(str, arguments)])


def tune(arguments):
    return main(["tune", *map(str, arguments)])


def study(arguments):
    return main(["study", *map(str, arguments)])


def export(arguments):
    return main(["export", *map(str, arguments)])
