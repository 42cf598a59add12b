"""The measurement models, under the library's own name: everything that the package ``factors`` exports."""

from factors import *  # noqa: F403
from factors import __all__ as __all__
