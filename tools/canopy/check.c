// canopy check: the exact verdict.

#include <inttypes.h>
#include <math.h>
#include <stdio.h>

#include "tools/canopy/command.h"
#include "tools/canopy/operands.h"
#include "tools/common/progress.h"
#include "tools/common/supply.h"

static const char DOC[] =
    "Is every point on the safe side of the surrogate?\v"
    "Points are read as the device receives them: with p an input coordinate and `unit` the surrogate's, f32 takes "
    "(float)(p / unit) and fx takes rint(p / unit). The verdict is exact: what double arithmetic leaves open is "
    "decided in whole numbers of any length.\n\n" CANOPY_OPERANDS_POINTS
    "Prints one line: points, how many are on the wrong side and how many outside the frame, the worst margin and the "
    "mean and largest gap in per cent of the points' height range.\n\n"
    "Whether two surrogates cross, `canopy sandwich --check` decides.\n\n"
    "Exit status: 0 if every point is on the safe side, 1 if not (a point outside the frame is not), 2 for bad input.";

static void print_verdict(const struct canopy_exact_result *r, const struct canopy_points_info *info, double unit) {
    printf("%s: %" PRIu64 " point%s%s, %" PRIu64 " on the wrong side, %" PRIu64 " outside the frame",
           canopy_exact_is_safe(r) ? "safe" : "NOT SAFE", r->points, r->points == 1 ? "" : "s",
           canopy_points_skipped(info).text, r->wrong, r->outside);
    if (r->points > r->outside) {
        printf(", worst margin %.3g (%.3g device units), mean gap %.4g%% of %s, max %.3g%%", r->margin * unit,
               r->margin, canopy_exact_mean_gap(r), canopy_exact_gap_base(r), canopy_exact_max_gap(r));
    }
    if (r->first_wrong != UINT64_MAX) {
        printf(", first wrong: point %" PRIu64, r->first_wrong + 1);
    }
    if (r->first_outside != UINT64_MAX) {
        printf(", first outside: point %" PRIu64, r->first_outside + 1);
    }
    putchar('\n');
}

int canopy_command_check(int argc, char **argv) {
    const struct canopy_operands operands = canopy_operands_both(argc, argv, DOC);
    struct canopy_fault fault;
    struct canopy_surrogate surrogate;
    if (!canopy_surrogate_read(operands.surrogate, &surrogate, &fault)) {
        return canopy_command_fail(&fault);
    }
    struct canopy_exact_result result;
    struct canopy_points_info info;
    const bool ok =
        canopy_supply_check_file(operands.points, &surrogate, canopy_flow_threads(), &result, &info, &fault);
    canopy_progress_end();
    if (ok) {
        print_verdict(&result, &info, surrogate.unit);
    }
    canopy_surrogate_free(&surrogate);
    if (!ok) {
        return canopy_command_fail(&fault);
    }
    return canopy_exact_is_safe(&result) ? CANOPY_EXIT_OK : CANOPY_EXIT_UNSAFE;
}
