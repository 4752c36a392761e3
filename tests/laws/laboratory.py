"""Laws as a lab would write them; none of them shares code with the published ones."""

import numpy as np

from stickslip_fit.laws import Configuration, Parameter, StepLaw


class Guide(StepLaw):
    """Joint 3: (a - c cos(psi - q2) cos theta) (1 - b |cos q2|), by the general quadrature."""

    name = "guide"
    joint = 3
    columns = ("q2", "theta", "psi")
    parameters = (
        Parameter("free", "nm", "step size of the free arm", lower=0.0),
        Parameter("recoil", "1", "share lost"),
        Parameter("weight", "nm", "lost to gravity"),
    )
    configurations: tuple[Configuration, ...] = ()

    def factors(self, state, values):
        load = np.cos(state.psi - state.q2) * np.cos(state.theta)
        free, recoil, weight = (values[:, k, None] for k in range(3))
        back = np.abs(np.cos(state.q2))
        return free - weight * load, 1.0 - recoil * back, load, back

    def gamma(self, state, values):
        net, kept, _, _ = self.factors(state, values)
        return net * kept

    def gamma_slopes(self, state, values):
        net, kept, load, back = self.factors(state, values)
        return np.stack(np.broadcast_arrays(kept, -net * back, -kept * load), axis=-1)

    def start_values(self, mean_step):
        return np.stack([1.2 * mean_step, np.full_like(mean_step, 0.2), np.zeros_like(mean_step)], axis=-1)

    def scales(self, mean_step):
        return np.stack([mean_step, np.ones_like(mean_step), mean_step], axis=-1)

    def features(self, rows):
        return np.stack([np.asarray(rows[name], dtype=float) for name in self.columns], axis=-1)

    def calibration(self):
        return self.configurations


class Eccentric(Guide):
    """Joint 1: g (1 + A sin(q1))."""

    name = "eccentric"
    joint = 1
    columns = ()
    parameters = (Parameter("g", "µrad", "mean step size", lower=0.0), Parameter("A", "%", "swing"))

    def gamma(self, state, values):
        return values[:, :1] * (1.0 + values[:, 1:] * np.sin(state.position))

    def gamma_slopes(self, state, values):
        sine = np.sin(state.position)
        return np.stack([1.0 + values[:, 1:] * sine, values[:, :1] * sine], axis=-1)

    def start_values(self, mean_step):
        return np.stack([mean_step, np.zeros_like(mean_step)], axis=-1)

    def scales(self, mean_step):
        return np.stack([mean_step, np.ones_like(mean_step)], axis=-1)

    def features(self, rows):
        return np.zeros((len(rows["start"]), 0))


class Doubled(Guide):
    """The free step in two parts that no count tells apart."""

    name = "doubled"
    parameters = (*Guide.parameters, Parameter("more", "nm", "also of the free arm"))

    def together(self, values):
        return np.concatenate([values[:, :1] + 2.0 * values[:, 3:], values[:, 1:3]], axis=1)

    def gamma(self, state, values):
        return super().gamma(state, self.together(values))

    def gamma_slopes(self, state, values):
        slopes = super().gamma_slopes(state, self.together(values))
        return np.concatenate([slopes, 2.0 * slopes[..., :1]], axis=-1)

    def start_values(self, mean_step):
        return np.concatenate([super().start_values(mean_step), 0.1 * mean_step[:, None]], axis=1)

    def scales(self, mean_step):
        return np.concatenate([super().scales(mean_step), mean_step[:, None]], axis=1)


def slope(load, free, weight):
    """The step size by the load alone."""
    return free - weight * load


GUIDE = Guide()
EVERY_JOINT = {1: Eccentric(), 3: GUIDE}
NUMBER = 5
