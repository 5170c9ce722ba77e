"""Evidence that nobody measured: every part of the page filled, with names that try to be markup."""

from __future__ import annotations

from dataclasses import replace

from safety_harness.claims.properties.tally import ASSUMPTIONS, EXCLUSIONS
from safety_harness.extensions.assurance.certification.evidence import (
    FORMAT,
    ArgumentNote,
    Bound,
    CalibrationCheck,
    CertifiedClaim,
    CertifiedProofs,
    ClaimEvidence,
    ClaimResult,
    ClaimStatus,
    CounterexampleEvidence,
    DeclaredPlan,
    Evidence,
    EvidenceProvenance,
    HazardEvidence,
    HourlyBound,
    LearnedPart,
    OpenFinding,
    OverrulingResult,
    Quantile,
    Record,
    SearchSummary,
    SeparationCase,
    SeparationTerm,
    StandardTerm,
    StoredFile,
    StratumResult,
    SystemDescription,
    TrainingDistance,
    WhoseFault,
)
from safety_harness.extensions.assurance.certification.learned import LIFE
from safety_harness.extensions.assurance.certification.tools import (
    CaughtFault,
    CellCount,
    CoverageOfRuns,
    Credibility,
    Oracle,
    Rerun,
    SelfTest,
    WorldAgreement,
)
from safety_harness.extensions.lab.proof.maps import CELLS, BoxMap
from safety_harness.trace.system import Component, SystemUnderTest

HOSTILE = "<script>alert(1)</script><b>bold</b> & \"quoted\" 'single'"
STRATA = ("seen", "unseen hand", f"odd {HOSTILE}")
HASH = "9551328ce598ae35f857ee9047afb698f45fa4ce132f13d84bcda0cb98b7959d"


def bound(lower: float, upper: float) -> Bound:
    return Bound(lower=lower, upper=upper, confidence=0.9917, method="Clopper and Pearson, two-sided")


def outcome(
    stratum: str, standing: ClaimStatus, *, violated: int = 0, without: int = 0, upper: float = 0.0016
) -> ClaimResult:
    untested = 3000 if standing is ClaimStatus.UNTESTED else 40
    none = untested == 3000
    return ClaimResult(
        stratum=stratum,
        planned=3000,
        runs=3000,
        holds=3000 - violated - without - untested,
        violated=violated,
        inconclusive=without,
        failed=0,
        untested=untested,
        bound=None if none else bound(0.3 * violated / 3000, upper),
        standing=standing,
        why="not one of 3000 runs put it to the test" if none else f"{violated} of 2960 runs violated it",
        least_margin_si=None if none else -0.041 if violated else 0.012,
        margins_si=() if none else tuple(0.001 * (k * k / 20 - (40 if violated else -12)) for k in range(60)),
        shares=() if none else tuple((k + 1) ** 2 / 3600 for k in range(60)),
        quantiles=()
        if none
        else (Quantile(share=0.99, at_least_si=0.021), Quantile(share=0.999, at_least_si=-0.002)),
    )


def claim(
    number: int, sentence: str, standing: ClaimStatus, outcomes: tuple[ClaimResult, ...]
) -> ClaimEvidence:
    return ClaimEvidence(
        number=number,
        sentence=sentence,
        target=None if standing is ClaimStatus.ESTIMATED else 0.002,
        hazard="crushing between arm and hand",
        hazard_is_authors=number == 1,
        terms=(StandardTerm(standard="ISO/TS 15066", term="protective separation distance S_p (5.5.4)"),),
        rationale="The hand must never come nearer than this to any part of the arm.",
        exercised_when="a hand comes within 400 mm of the arm",
        unit="mm",
        per_si=1e3,
        standing=standing,
        why=outcomes[-1].why,
        outcomes=outcomes,
    )


def claims() -> tuple[ClaimEvidence, ...]:
    made = (
        ("hand distance never below 50 mm", ClaimStatus.REFUTED, 31, 0, 0.0171),
        ("moves away from the hand", ClaimStatus.SHOWN, 0, 0, 0.0016),
        ("joint speeds within limits", ClaimStatus.DOUBTED, 0, 3, 0.0019),
        ("protective separation kept", ClaimStatus.NOT_SHOWN, 2, 0, 0.0031),
        ("stops within 600 ms", ClaimStatus.UNTESTED, 0, 0, 0.0),
        (f"always hand distance > 30 mm {HOSTILE}", ClaimStatus.ESTIMATED, 4, 0, 0.004),
    )
    return tuple(
        claim(
            number,
            sentence,
            standing,
            tuple(
                outcome(name, standing, violated=violated, without=without, upper=upper) for name in STRATA
            ),
        )
        for number, (sentence, standing, violated, without, upper) in enumerate(made, start=1)
    )


def hazards() -> tuple[HazardEvidence, ...]:
    """One with a rate for each of its claims, and one of which nothing is assessed, with no claim."""
    crushed = HazardEvidence(
        name="crushed hand",
        task="parts are taken from the table",
        zone="above the table",
        body_region="hand and forearm",
        event="a hand reaches past the object",
        severity="S2",
        exposure="F1",
        avoidance="P2",
        decided_by="whoever made this up",
        because="it is made up",
        steps=("severity S2", "by a graph: level d, at most 1e-06 an hour"),
        level="d",
        asked_an_hour=1e-6,
        claims=(1, 2),
        approaches="37 approaches in 12 h (two shifts)",
        approaches_an_hour=4.25,
        rate_confidence=0.975,
        rates=(
            HourlyBound(claim=1, stratum="seen", per_run=0.02, an_hour=0.085),
            HourlyBound(claim=2, stratum="seen", per_run=0.002, an_hour=0.0085),
        ),
    )
    other = replace(
        crushed,
        name=f"other {HOSTILE}",
        task=f"task {HOSTILE}",
        zone=f"zone {HOSTILE}",
        body_region=f"region {HOSTILE}",
        event=f"event {HOSTILE}",
        decided_by=f"someone {HOSTILE}",
        because=f"why {HOSTILE}",
        severity="not assessed",
        steps=("severity not assessed: no level follows",),
        level=None,
        asked_an_hour=None,
        claims=(),
        approaches=f"source {HOSTILE}",
        rates=(),
    )
    return crushed, other


def evidence(*, only_shown: bool = False, counterexamples: int = 2) -> Evidence:
    every = tuple(one for one in claims() if not only_shown or one.standing is ClaimStatus.SHOWN)
    return Evidence(
        format=FORMAT,
        interrupted=False,
        plan=DeclaredPlan(
            name=f"mc-dropout beside a reaching hand {HOSTILE}",
            about="A UR10 with an eye-in-hand camera servoes beside one person who reaches onto the table.",
            file="plan.yaml",
            sha256=HASH,
            text=f"plan: mc-dropout {HOSTILE}\nconfidence: 95 %\n",
            world="PyBullet",
            model_only=False,
            confidence=0.95,
            per_bound_confidence=0.9972,
            bounds=18,
            seed=1,
            stop_early=False,
            search_runs=2000,
        ),
        standing=ClaimStatus.SHOWN if only_shown else ClaimStatus.REFUTED,
        strata=tuple(
            StratumResult(
                name=name,
                space="spaces/nominal.yaml",
                about="a hand comes near, stays and leaves",
                space_sha256=HASH,
                planned=3000,
                made=3000,
                failed=0,
                refused_draws=112,
                decisions=(("proposed position", 2811), ("opposite pose", 120), ("protective stop", 69)),
                random_traces=20,
                violation_traces=7,
            )
            for name in STRATA
        ),
        overruling=tuple(
            OverrulingResult(
                stratum=name,
                proposals=3000,
                overruled=189,
                words="overruled 189 of 3,000 proposals (6.3 %): 150 uncertain, 39 table; 120 replaced "
                "by the opposite pose, 69 by a stop",
                runs=2960,
                runs_overruled=160,
                bound=bound(0.0462, 0.0629),
            )
            for name in STRATA
        ),
        claims=every,
        system=SystemDescription(
            under_test=(
                SystemUnderTest(
                    controller=Component(name="visual servo", sha256=HASH),
                    avoider=Component(name="mc-dropout", sha256=HASH),
                    gate=Component(name="full gate", sha256=HASH),
                    perception=Component(name="hands overhead, object exact", sha256=HASH),
                    robot=Component(name="UR10", sha256=HASH),
                    settings=Component(name="settings", sha256=HASH),
                ),
            ),
            card=(
                ("Network", "regression ResNet, dropout after each stage"),
                ("Data: how many", "5,000,000 samples"),
            ),
            limits=("says nothing useful about TCPs and hands outside the seen space",),
            gate=(("Kind", "full"), ("Spread at most", "17.8 mm"), ("Decision deadline", "100 ms")),
            settings=(("avoidance.critical_distance_m", "400 mm"), ("clock.control_period_s", "0.008 s")),
            changed=(),
        ),
        assumptions=ASSUMPTIONS,
        exclusions=EXCLUSIONS,
        separation=tuple(
            SeparationCase(
                stratum=name,
                run="episode 112",
                time_s=1.952,
                distance_m=0.31,
                required_m=1.05,
                hand_speed_mps=1.6,
                robot_speed_mps=0.25,
                terms=tuple(
                    SeparationTerm(symbol=symbol, length_m=length, meaning="as the standard has it")
                    for symbol, length in (
                        ("S_h", 0.76),
                        ("S_r", 0.025),
                        ("S_s", 0.047),
                        ("C", 0.0),
                        ("Z_d", 0.006),
                        ("Z_r", 0.001),
                    )
                ),
            )
            for name in STRATA
        ),
        calibration=tuple(
            CalibrationCheck(
                stratum=name,
                sentence="95 % intervals hold the target in at least 90 % of decisions",
                decided=decided,
                why="190 of 200 hold eq. 13 with candidates drawn afresh: 95.0 %, between 91.0 % and 97.6 %",
                decisions=200,
            )
            for name, decided in zip(STRATA, ("holds", "violated", "inconclusive"), strict=True)
        ),
        coverage=CoverageOfRuns(
            runs=60,
            without_hand=0,
            cells=(
                CellCount(
                    direction="right",
                    speed="to 1 m/s",
                    distance="to 200 mm",
                    seen="seen",
                    outcome="proposed position",
                    runs=41,
                    violating=0,
                ),
                CellCount(
                    direction="above",
                    speed="above 1 m/s",
                    distance="to 50 mm",
                    seen="hand unseen",
                    outcome="protective stop",
                    runs=19,
                    violating=4,
                ),
            ),
            about="The declared random runs whose traces are stored.",
        ),
        counterexamples=tuple(
            CounterexampleEvidence(
                number=number,
                claim=1,
                sentence=f"hand distance never below 50 mm {HOSTILE}",
                origin="run 412 of unseen hand" if number == 1 else "the search",
                independent=number == 1,
                like_it=12,
                margin="\u2212126.5 mm",
                scenario_file="counterexamples/one.yaml",
                trace_file="counterexamples/one.trace",
                command="safety-harness replay counterexamples/one.trace",
                lines=("without the second move it does not happen", f"seen space: {HOSTILE}"),
            )
            for number in range(1, counterexamples + 1)
        ),
        whose_fault=WhoseFault(
            about="20 of 31 violations, in 20 episodes",
            groups=(("critical distance", 12), ("unavoidable", 8)),
            would_help=((f"critical distance (x 2) {HOSTILE}", 12),),
        ),
        search=SearchSummary(runs=2000, searcher="default", lines=("2000 runs, 14 distinct violations",)),
        credibility=Credibility(
            agreement=WorldAgreement(
                scenarios=562,
                verdicts=16141,
                disagreements=0,
                optimistic=0,
                differences=(("joint position", "0.7 mrad"), ("TCP position", "0.33 mm")),
                source_hash="0123456789abcdef",
                present=False,
            ),
            reruns=(
                Rerun(
                    place="step-size",
                    title="Finer physics steps",
                    how="with 8 physics steps a control tick in place of 4",
                    runs=10,
                    verdicts=60,
                    changed=0,
                    optimistic=0,
                    largest=(("hand distance never below 50 mm", "0.02 mm"),),
                ),
            ),
            oracles=(Oracle(part="kinematics", against="PyBullet", largest="2e-15 m"),),
            oracles_measured_with="this very source",
            absent=("No measurement on a real cell.",),
        ),
        selftest=SelfTest(
            profile="quick",
            faults=(
                CaughtFault(
                    name="sign of the error",
                    part="servoing",
                    hazard="the arm runs away",
                    caught_by="converged",
                    smallest="1",
                ),
                CaughtFault(
                    name="late gate",
                    part="gate",
                    hazard="a doubtful answer is used",
                    caught_by="",
                    smallest="",
                ),
            ),
            false_alarms=(),
            source_hash="0123456789abcdef",
            present=True,
            whole=True,
        ),
        selftest_absent="",
        findings=()
        if only_shown
        else (
            OpenFinding(text="hand distance never below 50 mm is refuted in 3 strata", place="claim-1"),
            OpenFinding(text="stops within 600 ms was never put to the test", place="claim-5"),
        ),
        record=Record(rows_sha256=HASH, declaration_sha256=""),
        provenance=EvidenceProvenance(
            package_version="0.1.0",
            source_hash="0123456789abcdef",
            python="3.11.9",
            platform="Linux x86_64",
            machine="2 cores",
            libraries=(("numpy", "2.4.6"),),
            command="safety-harness certify plan.yaml",
            commands=("safety-harness certify plan.yaml", "safety-harness verify ."),
            began_at="2026-11-21 17:45:00 UTC",
            ended_at="2026-11-21 19:45:00 UTC",
            run_seconds_s=5400.0,
        ),
        files=(StoredFile(path="ledger.sqlite", sha256=HASH, bytes=123456),),
        proven=None if only_shown else proven(),
        hazards=() if only_shown else hazards(),
        notes=() if only_shown else (ArgumentNote(element="defeater: judges", text=f"asked {HOSTILE}"),),
        learned=None if only_shown else learned(),
    )


def learned() -> LearnedPart:
    return LearnedPart(
        networks=(("mc-dropout", HASH),),
        seen=("mc-dropout",),
        strata=tuple(
            TrainingDistance(
                stratum=name,
                runs=(2811, 149, 0, 40),
                decisions=decisions,
                share_outside=0.25 if decisions else None,
                median_outside_m=0.017 if decisions else None,
                largest_outside_m=0.028 if decisions else None,
            )
            for name, decisions in zip(STRATA, (40, 12, 0), strict=True)
        ),
        life=LIFE,
    )


def proven() -> CertifiedProofs:
    rows = ("0" * CELLS,) * (CELLS - 1) + ("-" + "4" * (CELLS - 1),)
    ends = {"low_m": (0.54, -0.65), "high_m": (1.14, -0.05)}
    drawn = BoxMap(who="hand", seen="from above", axes="xy", what="refuted", rows=rows, **ends)
    one = CertifiedClaim(
        claim=f"leads away {HOSTILE}",
        region=f"near {HOSTILE}",
        verdict="refuted",
        confirmed=f"refuted: away 0 m {HOSTILE}",
        maps=(drawn,),
        gates=(f"{HOSTILE}: no gate keeps to a region.",),
    )
    return CertifiedProofs(network_sha256=HASH, claims=(one,))
