import inspect

from discover import examples, modules, nested_types

from mcmc1d.estimators import Estimator
from mcmc1d.moves import Move
from mcmc1d.targets import Target
from mcmc1d.techniques import Technique
from mcmc1d.weights import Weights


def test_every_final_class_stands_in_an_examples_mapping():
    bases = (Technique, Move, Target, Weights, Estimator)
    final = {
        cls
        for module in modules("mcmc1d")
        for cls in vars(module).values()
        if inspect.isclass(cls)
        and cls.__module__ == module.__name__
        and issubclass(cls, bases)
        and not inspect.isabstract(cls)
    }
    shown = set().union(*map(nested_types, examples("mcmc1d").values()))
    assert len(final) >= 20  # the search found the library
    missing = sorted(f"{cls.__module__}.{cls.__name__}" for cls in final - shown)
    assert not missing, f"give each an example in its module's EXAMPLES: {missing}"
