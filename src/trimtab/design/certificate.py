"""Certificate of a gain: the matrices, weights, claims and system name that suffice to prove the gain again.

`design_certificate` creates a certificate. `certificate_file` stores the certificate as text without losing a digit.
`certificate_check.prove_certificate` proves the certificate without the solver that found the gain. A certificate
applies to the linear model of a named system: near the operating point, and only while no input saturates.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 14, 15, corrected as in `composite`.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab import __version__
from trimtab.core.errors import InputError, argument
from trimtab.design import composite
from trimtab.design.certified_system import CertifiedSystem, Setting
from trimtab.design.lmi import LmiGain, lmi_gain
from trimtab.design.lqr import KalmanBucy, Lqr, kalman_bucy, lqr
from trimtab.design.poles import sorted_poles

ABOVE = 1.01
"""Weight of the observer in the Lyapunov function, relative to the smallest weight that allows a proof."""
METHODS = ("lqr", "lmi")


class ObserverPart(NamedTuple):
    """Observer of some of the states, as part of a certificate.

    estimated: names of the k estimated states.  A: A_eta (k, k).  C: (p, k).  Q: Q_eta (k, k).  R: (p, p).  P:
    P_eta (k, k). L: (k, p).  weight: weight of the observer's part of the Lyapunov function.  least_weight: lambda*;
    inequality (15) holds for larger weights.  poles: poles of A - L C (k,).
    """

    estimated: tuple[str, ...]
    A: Any
    C: Any
    Q: Any
    R: Any
    P: Any
    L: Any
    weight: float
    least_weight: float
    poles: Any


class Certificate(NamedTuple):
    """Gain K of the feedback v = +K e (input v, state error e), with all data needed to prove the gain.

    system: name of the system, as in `trimtab design SYSTEM`.  about: settings and operating point by name.
    method: "lqr" or "lmi".  states, inputs: names.  A: (n, n).  B: (n, m).  K: (m, n).  P: (n, n).  Qe: (n, n) and Re:
    (m, m), the weights in (14).  Q: weight of the regulator (n, n), None for "lmi".  scale: sizes of the states (n,).
    poles: poles of A + B K (n,).  observer: None if the whole state is measured.  recorded: further computed figures of
    the system, name -> value.  version: version of this package.
    """

    system: str
    about: dict[str, Setting]
    method: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    A: Any
    B: Any
    K: Any
    P: Any
    Qe: Any
    Re: Any
    Q: Any
    scale: Any
    poles: Any
    observer: ObserverPart | None
    recorded: dict[str, float]
    version: str = __version__

    def feedback_matrices(self) -> composite.Feedback:
        """Return the feedback's matrices as floats."""
        return composite.Feedback(self.A, self.B, self.K, self.P, self.Qe, np.linalg.inv(self.Re))

    def estimated_indices(self) -> Any:
        """Return the indices of the estimated states in e (k,)."""
        return np.array([self.states.index(n) for n in self.observer.estimated] if self.observer else [], int)

    def observer_matrices(self, o: ObserverPart) -> composite.Observer:
        """Return the observer's matrices as floats."""
        return composite.Observer(o.A, o.C, o.Q, o.P, o.L, np.linalg.inv(o.R), self.estimated_indices())


def design_certificate(system: CertifiedSystem) -> Certificate:
    """Design a system's gain and, if states are estimated, its steady Kalman filter; return a certificate of both."""
    s = system
    if s.method not in METHODS:
        raise InputError("method", f"unknown method {s.method!r}", choices=METHODS, fix=argument("method", "lqr"))
    if s.method == "lqr":
        gain = lqr(s.A, s.B, s.Q, s.Re, scale=s.scale)
    else:
        gain = lmi_gain(s.A, s.B, s.Qe, s.Re, scale=s.scale)
    return build_certificate(s, gain, kalman_bucy(s.A_eta, s.C, s.Q_eta, s.R) if s.estimated else None)


def build_certificate(system: CertifiedSystem, gain: Lqr | LmiGain, kalman: KalmanBucy | None) -> Certificate:
    """Assemble a certificate that is not yet proved. `certificate_check.prove_certificate` proves it.

    Args:
        system: the certified system.
        gain: K (m, n) and P (n, n).
        kalman: filter of the system's estimated states; None if no state is estimated.
    """
    s = system
    certificate = Certificate(
        system=s.name,
        about=dict(s.about),
        method=s.method,
        states=s.states,
        inputs=s.inputs,
        A=s.A,
        B=s.B,
        K=gain.K,
        P=(gain.P + gain.P.T) / 2,
        Qe=s.Qe,
        Re=s.Re,
        Q=s.Q,
        scale=s.scale,
        poles=sorted_poles((s.A + s.B @ gain.K) * s.scale / s.scale[:, None]),
        observer=None,
        recorded={name: number.value for name, number in s.numbers(gain.K).items()},
    )
    if kalman is None:
        return certificate
    P = (kalman.P + kalman.P.T) / 2
    part = ObserverPart(s.estimated, s.A_eta, s.C, s.Q_eta, s.R, P, kalman.L, 1.0, 0.0, kalman.poles)
    certificate = certificate._replace(observer=part)
    feedback, observer = certificate.feedback_matrices(), certificate.observer_matrices(part)
    least = composite.least_weight(feedback, observer)
    falls = [composite.least_decrease_weight(feedback, observer, r) for r in (0.0, 0.5, -0.5)]
    finite = [w for w in (least, *falls) if np.isfinite(w)]
    weight = ABOVE * max(finite) if finite else 1.0
    return certificate._replace(observer=part._replace(weight=weight, least_weight=least))
