"""How much coverage is good? The same drives with sets calibrated to ever more of it."""

import dosplan

if __name__ == "__main__":
    print("coverage  success  collision  velocity  median cycle")
    for coverage in (0.5, 0.9):
        results = dosplan.run_suite(
            planner="idm",
            predictor="dos",
            predictor_options={"coverage": coverage},
            arms=(dosplan.Arm.WITH_DOS,),
            limit=1,  # For a figure that means something: leave this out, and the planner too.
            out=f"runs/coverage-{coverage}",
        )
        arm = results.summary.arms[dosplan.Arm.WITH_DOS]
        print(
            f"{coverage:8.2f}  {arm['success_rate']:7.1%}  {arm['collision_rate']:9.1%}"
            f"  {arm['velocity']:4.1f} m/s  {arm['cycle_ms_p50']:9.1f} ms"
        )
