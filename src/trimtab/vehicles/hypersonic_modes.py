"""The two bending modes of the hypersonic vehicle, and the algebraic loop that ties them to the pitch acceleration.

[1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, eqs. 1-3. [2] Parker, Serrani, Yurkovich, Bolender, Doman, "Control-oriented
modeling of an air-breathing hypersonic vehicle", Journal of Guidance, Control, and Dynamics 30(3), 2007.
"""

from typing import Any

from trimtab.core.record import Scalar, option, quantity, record, replace

KMODES = ("parker", "paper", "author")
FITTED = "reconstructed from a printed entry of [1]'s A, see docs page"
UNCERTAIN = "literature, uncorroborated; docs page"


@record
class FlexibleModes:
    """Two bending modes, mass-normalised, excited by angle of attack, elevator and pitch acceleration.

        k_i eta_i'' = r_i - psi_i M/Iyy - (psi_1 psi_2/Iyy) eta_j''      r_i = N_i - 2 zeta_i w_i eta_i' - w_i^2 eta_i
        Iyy Q' = M + psi_1 eta_1'' + psi_2 eta_2''                                                        [1, eq. 1]

    Both rows contain each other's accelerations; they are solved exactly. [1] leaves k_i undefined. `kmode`:

    - parker: k_i = 1 + psi_i^2/Iyy, that is eta_i'' = r_i - psi_i Q' and Q' = (M + psi_1 r_1 + psi_2 r_2)/J with
      J = Iyy + psi_1^2 + psi_2^2 [2];
    - paper: k_i = 1, eq. 1 to the letter;
    - author: psi_i/Iyy stands for psi_i in the flexible rows, as in the printed matrices of [1]. It mixes units and is
      there to reproduce them.

    Source:  [1] eqs. 1-3; [2]. Reconstructed: frequencies, damping, psi_i and most of N_i, see docs page.
    """

    w1: Scalar = quantity("rad/s", "Natural frequency of mode 1.", default=16.5, above=0, source=FITTED)
    w2: Scalar = quantity("rad/s", "Natural frequency of mode 2.", default=20.0, above=0, source=FITTED)
    zeta1: Scalar = quantity("1", "Damping ratio of mode 1.", default=0.02, low=0, source=FITTED)
    zeta2: Scalar = quantity("1", "Damping ratio of mode 2.", default=0.02, low=0, source=FITTED)
    psi1: Scalar = quantity("(slug ft)^1/2", "Coupling of mode 1 with pitch.", default=136.82, source=FITTED)
    psi2: Scalar = quantity("(slug ft)^1/2", "Coupling of mode 2 with pitch.", default=329.22, source=FITTED)
    N1_a2: Scalar = quantity("(slug ft)^1/2/s^2", "By alpha squared (rad).", default=1.4013e3, source=UNCERTAIN)
    N1_a: Scalar = quantity("(slug ft)^1/2/s^2", "By alpha (rad).", default=4.5737e3, source=FITTED)
    N1_0: Scalar = quantity("(slug ft)^1/2/s^2", "Else.", default=1.1752e2, source=UNCERTAIN)
    N2_a2: Scalar = quantity("(slug ft)^1/2/s^2", "By alpha squared (rad).", default=-5.0227e3, source=UNCERTAIN)
    N2_a: Scalar = quantity("(slug ft)^1/2/s^2", "By alpha (rad).", default=2.8633e3, source=FITTED)
    N2_d: Scalar = quantity("(slug ft)^1/2/s^2", "By elevator (rad).", default=1.2465e3, source=FITTED)
    N2_0: Scalar = quantity("(slug ft)^1/2/s^2", "Else.", default=-4.4201e1, source=UNCERTAIN)
    kmode: str = option("Reading of the coupling.", default="parker", choices=KMODES)

    def forcing(self, alpha: Any, delta_e: Any) -> tuple[Any, Any]:
        """N1, N2: generalised forces of angle of attack and elevator (rad)."""
        N1 = (self.N1_a2 * alpha + self.N1_a) * alpha + self.N1_0
        N2 = (self.N2_a2 * alpha + self.N2_a) * alpha + self.N2_d * delta_e + self.N2_0
        return N1, N2

    def restoring_forces(self, eta1: Any, eta1_rate: Any, eta2: Any, eta2_rate: Any) -> tuple[Any, Any]:
        """-2 zeta_i w_i eta_i' - w_i^2 eta_i of both modes."""
        one = -2 * self.zeta1 * self.w1 * eta1_rate - self.w1**2 * eta1
        two = -2 * self.zeta2 * self.w2 * eta2_rate - self.w2**2 * eta2
        return one, two

    def static_displacements(self, alpha: Any, delta_e: Any) -> tuple[Any, Any]:
        """N_i/w_i^2: the displacements at which both modes rest while the pitch rate does not change."""
        N1, N2 = self.forcing(alpha, delta_e)
        return N1 / self.w1**2, N2 / self.w2**2

    def detune(self, by: Any) -> "FlexibleModes":
        """A copy with both frequencies times `by`: the plant of a filter that has them wrong."""
        return replace(self, w1=self.w1 * by, w2=self.w2 * by)

    def solve_accelerations(self, Iyy: Any, M: Any, r1: Any, r2: Any) -> tuple[Any, Any, Any]:
        """Q' (rad/s^2), eta1'', eta2'' of moment M and modal forces r1, r2: the three equations, solved exactly.

        Args:
            Iyy: moment of inertia (slug ft^2/ft).
            M: pitching moment (lbf ft/ft).
            r1: N1 and restoring force of mode 1.
            r2: the same of mode 2.
        """
        if self.kmode == "parker":
            J = Iyy + self.psi1**2 + self.psi2**2
            Q_rate = (M + self.psi1 * r1 + self.psi2 * r2) / J
            return Q_rate, r1 - self.psi1 * Q_rate, r2 - self.psi2 * Q_rate
        t1, t2 = self.psi1 / Iyy, self.psi2 / Iyy
        p1, p2 = (t1, t2) if self.kmode == "author" else (self.psi1, self.psi2)
        k = t1 * t2 if self.kmode == "author" else self.psi1 * t2
        s1, s2 = r1 - p1 * M / Iyy, r2 - p2 * M / Iyy
        eta1_acceleration = (s1 - k * s2) / (1 - k * k)
        eta2_acceleration = (s2 - k * s1) / (1 - k * k)
        return M / Iyy + t1 * eta1_acceleration + t2 * eta2_acceleration, eta1_acceleration, eta2_acceleration
