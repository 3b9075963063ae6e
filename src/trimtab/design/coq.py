"""Certificates as files for the proof assistant Coq: positive definiteness and Lyapunov's inequality, as theorems.

The file contains an integer checker (Bareiss' elimination, in which each division is tested), the proof that the
checker is sound for all real vectors, and the certificate's floats as exact integers times a power of two. `coqc
FILE.v` accepts or rejects the file without relying on this package or on float arithmetic.

Source: [1] E. H. Bareiss, "Sylvester's identity and multistep integer-preserving Gaussian elimination", Math. Comp. 22
(1968); [2] The Coq Proof Assistant, reference manual 8.16.
"""

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

from trimtab.design.certificate import Certificate, ObserverPart
from trimtab.design.exact import as_fractions

PRELUDE = """\
From Coq Require Import ZArith List Reals Lra Lia.
Import ListNotations.

(* Matrices are lists of rows of integers; vectors are lists of real numbers. *)

Fixpoint dot (r : list Z) (x : list R) : R :=
  match r, x with
  | a :: r', v :: x' => (IZR a * v + dot r' x')%R
  | _, _ => 0%R
  end.

(* z' M x *)
Fixpoint form (z : list R) (M : list (list Z)) (x : list R) : R :=
  match z, M with
  | v :: z', r :: M' => (v * dot r x + form z' M' x)%R
  | _, _ => 0%R
  end.

Definition nonzero (x : list R) : Prop := Exists (fun v => v <> 0%R) x.

Definition positive_definite (n : nat) (M : list (list Z)) : Prop :=
  forall x, length x = n -> nonzero x -> (0 < form x M x)%R.

(* One step of Bareiss' elimination; every division is checked to be exact. *)

Fixpoint reduce_row (before a c : Z) (r s : list Z) : option (list Z) :=
  match r, s with
  | [], [] => Some []
  | r0 :: r', s0 :: s' =>
      let whole := (a * s0 - c * r0)%Z in
      let q := (whole / before)%Z in
      if (q * before =? whole)%Z
      then option_map (cons q) (reduce_row before a c r' s')
      else None
  | _, _ => None
  end.

(* Reduce the rows below the pivot row. Remove their first entries, which must equal cs. *)
Fixpoint reduce (before a : Z) (r cs : list Z) (rows : list (list Z)) : option (list (list Z)) :=
  match cs, rows with
  | [], [] => Some []
  | c :: cs', (c' :: s) :: rows' =>
      if (c =? c')%Z
      then match reduce_row before a c r s, reduce before a r cs' rows' with
           | Some s', Some M' => Some (s' :: M')
           | _, _ => None
           end
      else None
  | _, _ => None
  end.

Fixpoint is_positive (n : nat) (before : Z) (M : list (list Z)) : bool :=
  match n, M with
  | O, [] => true
  | S n', (a :: r) :: rows =>
      if (0 <? a)%Z
      then match reduce before a r r rows with
           | Some M' => is_positive n' a M'
           | None => false
           end
      else false
  | _, _ => false
  end.

Lemma reduce_row_form : forall before a c r s s', reduce_row before a c r s = Some s' ->
  forall y, (IZR before * dot s' y = IZR a * dot s y - IZR c * dot r y)%R.
Proof.
  intros before a c r; induction r as [|r0 r IH]; intros [|s0 s] s' H y; simpl in H; try discriminate.
  - injection H as <-; simpl; ring.
  - destruct (Z.eqb_spec ((a * s0 - c * r0) / before * before) (a * s0 - c * r0)) as [E|]; [|discriminate].
    destruct (reduce_row before a c r s) as [t|] eqn:T; [|discriminate].
    injection H as <-; destruct y as [|v y]; simpl; [ring|].
    specialize (IH s t T y).
    apply (f_equal IZR) in E; rewrite mult_IZR, minus_IZR, !mult_IZR in E.
    set (q := IZR ((a * s0 - c * r0) / before)) in *.
    replace (IZR before * (q * v + dot t y))%R with (q * IZR before * v + IZR before * dot t y)%R by ring.
    rewrite E, IH; ring.
Qed.

Lemma reduce_form : forall before a r cs rows M, reduce before a r cs rows = Some M ->
  forall z x0 y, (IZR before * form z M y
    = IZR a * (form z rows (x0 :: y) - x0 * dot cs z) - dot cs z * dot r y)%R.
Proof.
  intros before a r cs; induction cs as [|c cs IH]; intros [|[|c' s] rows] M H z x0 y; simpl in H; try discriminate.
  - injection H as <-; destruct z; simpl; ring.
  - destruct (Z.eqb_spec c c') as [<-|]; [|discriminate].
    destruct (reduce_row before a c r s) as [s'|] eqn:E; [|discriminate].
    destruct (reduce before a r cs rows) as [M'|] eqn:F; [|discriminate].
    injection H as <-; destruct z as [|v z]; simpl; [ring|].
    pose proof (reduce_row_form _ _ _ _ _ _ E y) as G.
    specialize (IH rows M' F z x0 y).
    replace (IZR before * (v * dot s' y + form z M' y))%R
      with (v * (IZR before * dot s' y) + IZR before * form z M' y)%R by ring.
    rewrite G, IH; ring.
Qed.

Lemma dot_of_zero : forall r x, ~ nonzero x -> dot r x = 0%R.
Proof.
  induction r as [|a r IH]; intros [|v x] H; simpl; try reflexivity.
  assert (v = 0%R) as -> by (destruct (Req_dec v 0); [assumption|exfalso; apply H; left; assumption]).
  rewrite IH; [ring|intro N; apply H; right; exact N].
Qed.

Lemma form_of_zero : forall z M x, ~ nonzero x -> form z M x = 0%R.
Proof.
  induction z as [|v z IH]; intros [|r M] x H; simpl; try reflexivity.
  rewrite dot_of_zero, IH by assumption; ring.
Qed.

Lemma nonzero_decides : forall x : list R, nonzero x \\/ ~ nonzero x.
Proof.
  induction x as [|v x [H|H]].
  - right; intro N; inversion N.
  - left; right; exact H.
  - destruct (Req_dec v 0) as [->|N]; [right; intro N; inversion N; subst; auto|left; left; exact N].
Qed.

Theorem checker_is_sound : forall n before M, (0 < before)%Z ->
  is_positive n before M = true -> positive_definite n M.
Proof.
  induction n as [|n IH]; intros before [|[|a r] rows] B H [|x0 y] L N; simpl in *; try discriminate.
  - inversion N.
  - destruct (Z.ltb_spec 0 a) as [A|]; [|discriminate].
    destruct (reduce before a r r rows) as [M'|] eqn:E; [|discriminate].
    pose proof (reduce_form _ _ _ _ _ _ E y x0 y) as G.
    specialize (IH a M' A H y ltac:(lia)).
    apply IZR_lt in A, B.
    assert (K : (IZR a * (x0 * (IZR a * x0 + dot r y) + form y rows (x0 :: y))
      = (IZR a * x0 + dot r y) * (IZR a * x0 + dot r y) + IZR before * form y M' y)%R) by (rewrite G; ring).
    apply (Rmult_lt_reg_l (IZR a)); [assumption|]; rewrite Rmult_0_r, K.
    destruct (nonzero_decides y) as [Y|Y].
    + pose proof (Rmult_lt_0_compat _ _ B (IH Y)).
      pose proof (Rle_0_sqr (IZR a * x0 + dot r y)); unfold Rsqr in *; lra.
    + rewrite (dot_of_zero r y Y), (form_of_zero y M' y Y), Rmult_0_r, !Rplus_0_r.
      assert (x0 <> 0%R) by (inversion N; subst; [assumption|contradiction]).
      apply Rsqr_pos_lt; apply Rmult_integral_contrapositive_currified; lra.
Qed.

Definition column (j : nat) (M : list (list Z)) : list Z := map (fun r => nth j r 0%Z) M.
Definition transpose (n : nat) (M : list (list Z)) : list (list Z) := map (fun j => column j M) (seq 0 n).
Fixpoint product (r c : list Z) : Z :=
  match r, c with
  | a :: r', b :: c' => (a * b + product r' c')%Z
  | _, _ => 0%Z
  end.
(* M N, of a matrix N of n columns *)
Definition times (n : nat) (M N : list (list Z)) : list (list Z) :=
  map (fun r => map (product r) (transpose n N)) M.
Fixpoint combine_rows (f : Z -> Z -> Z) (r s : list Z) : list Z :=
  match r, s with
  | a :: r', b :: s' => f a b :: combine_rows f r' s'
  | _, _ => []
  end.
Fixpoint plus (M N : list (list Z)) : list (list Z) :=
  match M, N with
  | r :: M', s :: N' => combine_rows Z.add r s :: plus M' N'
  | _, _ => []
  end.
Definition opposite (M : list (list Z)) : list (list Z) := map (map Z.opp) M.
Definition scaled (c : Z) (M : list (list Z)) : list (list Z) := map (map (Z.mul c)) M.

Open Scope Z_scope.
"""
"""Quadratic forms, the checker, and the proof of its soundness."""


def coq_text(certificate: Certificate) -> str:
    """Return the text of a file for the proof assistant Coq (`coqc`), version 8.16 or newer."""
    c = certificate
    lines = [
        f"(* {_as_comment(c.system)}: " + _as_comment(", ".join(f"{k} {v}" for k, v in c.about.items())),
        f"   states {_as_comment(', '.join(c.states))}; inputs {_as_comment(', '.join(c.inputs))}",
        "   Each matrix is that of the certificate, float by float, times the power of two beside it. *)",
        "",
        PRELUDE,
        *_feedback_text(c),
    ]
    if c.observer is not None:
        lines += _observer_text(c.observer)
    lines.append("Print Assumptions checker_is_sound.")
    return "\n".join(lines) + "\n"


def _feedback_text(c: Certificate) -> Iterator[str]:
    """Yield Coq theorems on the feedback: e'P e is positive, and falls along e' = (A + B K) e."""
    n, powers = len(c.A), {name: _power(M) for name, M in {"A": c.A, "B": c.B, "K": c.K, "P": c.P}.items()}
    yield from (_matrix_text(name, getattr(c, name), power) for name, power in powers.items())
    most = max(powers["A"], powers["B"] + powers["K"])
    yield f"(* A + B K, times 2^{most} *)"
    yield f"Definition closed := plus (scaled (2 ^ {most - powers['A']}) A)"
    yield f"  (scaled (2 ^ {most - powers['B'] - powers['K']}) (times {n} B K))."
    yield "(* - (P (A + B K) + (A + B K)'P) *)"
    yield f"Definition lyapunov := opposite (plus (times {n} P closed) (transpose {n} (times {n} P closed)))."
    yield _theorem_text("P_is_positive_definite", "P", n)
    yield _theorem_text("V_falls", "lyapunov", n)


def _observer_text(o: ObserverPart) -> Iterator[str]:
    """Yield Coq theorems on the filter's matrix P_eta and its errors, e_eta' = (A_eta - L C) e_eta."""
    k, matrices = len(o.A), {"A_eta": o.A, "C": o.C, "L": o.L, "P_eta": o.P}
    powers = {name: _power(M) for name, M in matrices.items()}
    yield from (_matrix_text(name, matrices[name], power) for name, power in powers.items())
    most = max(powers["A_eta"], powers["L"] + powers["C"])
    yield f"(* A_eta - L C, times 2^{most} *)"
    yield f"Definition closed_eta := plus (scaled (2 ^ {most - powers['A_eta']}) A_eta)"
    yield f"  (opposite (scaled (2 ^ {most - powers['L'] - powers['C']}) (times {k} L C)))."
    yield "(* - ((A_eta - L C) P_eta + P_eta (A_eta - L C)') *)"
    yield f"Definition lyapunov_eta := opposite (plus (times {k} closed_eta P_eta)"
    yield f"  (transpose {k} (times {k} closed_eta P_eta)))."
    yield _theorem_text("P_eta_is_positive_definite", "P_eta", k)
    yield _theorem_text("V_eta_falls", "lyapunov_eta", k)


def _theorem_text(name: str, matrix: str, n: int) -> str:
    return (
        f"Theorem {name} : positive_definite {n} {matrix}.\n"
        "Proof. apply (checker_is_sound _ 1); [lia | vm_compute; reflexivity]. Qed.\n"
    )


def _matrix_text(name: str, M: Any, power: int) -> str:
    """Return a Coq definition of the matrix M as integers: its floats times 2^power."""
    rows = [f"  [{'; '.join(f'({int(v * Fraction(2) ** power)})' for v in row)}]" for row in as_fractions(M)]
    return f"(* {name}, times 2^{power} *)\nDefinition {name} : list (list Z) := [\n" + ";\n".join(rows) + "]%Z.\n"


def _power(M: Any) -> int:
    """Return the smallest exponent p >= 0 for which all entries times 2^p are integers."""
    return max(v.denominator for v in as_fractions(M).ravel()).bit_length() - 1


def _as_comment(text: str) -> str:
    """Return the text without characters that would end a Coq comment, or begin a comment or a string."""
    return text.replace("*", "").replace('"', "")
