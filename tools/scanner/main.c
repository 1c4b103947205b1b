// canopy-scanner: a line scanner that sweeps a point file, on real Modbus RTU and TCP, with every fault on a switch.

#include <argp.h>
#include <errno.h>
#include <inttypes.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lib/version.h"
#include "tools/common/option.h"
#include "tools/common/random.h"
#include "tools/common/sweep.h"
#include "tools/scanner/serve.h"

enum { EXIT_OK = 0, EXIT_OUTPUT = 1, EXIT_INPUT = 2, EXIT_USAGE = 64 };

struct arguments {
    const char *points;
    const char *served;
    struct canopy_sweep_options sweep;
    struct serve_options serve;
    bool progress, json, once;
    struct canopy_fault fault;
};

enum key {
    KEY_RTU = 0x100,
    KEY_TCP,
    KEY_PACE,
    KEY_PROFILES,
    KEY_COLUMNS,
    KEY_UNIT,
    KEY_RATE,
    KEY_LOOP,
    KEY_SEED,
    KEY_SEQUENCE,
    KEY_UNCERTAINTY,
    KEY_NOISE,
    KEY_DROPOUTS,
    KEY_TORN,
    KEY_STALE,
    KEY_LOST,
    KEY_SHORT,
    KEY_BAD_CRC,
    KEY_TRUNCATE,
    KEY_SILENCE,
    KEY_EXCEPTION,
    KEY_GARBAGE,
    KEY_DELAY,
    KEY_SERVED,
    KEY_PROGRESS,
    KEY_JSON,
    KEY_ONCE
};

static const struct argp_option table[] = {
    {NULL, 0, NULL, 0, "Wires (at least one):", 1},
    {"rtu", KEY_RTU, "LINE", 0,
     "Modbus RTU on PATH[,BAUD[,8E1[,UNIT]]]: opens the device PATH, or makes a pseudo-terminal and links PATH to it "
     "('pty': only prints its name); 115200, 8E1 and unit 1 unless told",
     1},
    {"tcp", KEY_TCP, "HOST:PORT[,UNIT]", 0,
     "Modbus TCP; port 0 takes a free one and prints it; units 0, 255 and UNIT (1) are answered", 1},
    {"pace", KEY_PACE, NULL, 0, "bytes take on the line the time that the baud rate says", 1},
    {NULL, 0, NULL, 0, "The sweep:", 2},
    {"profiles", KEY_PROFILES, "N", 0, "lines across the scene (the points' own lattice, or what suits their number)",
     2},
    {"columns", KEY_COLUMNS, "N", 0,
     "readings a profile, at most 4096 (the points' own lattice, or what suits their number, at most 488)", 2},
    {"unit", KEY_UNIT, "U", 0, "input units a device unit (the power of ten that gives the extent 10^5 to 10^6)", 2},
    {"rate", KEY_RATE, "HZ", 0,
     "a new profile HZ times a second, read or not; without it the next one comes when the master has read all of the "
     "last one and looks again",
     2},
    {"loop", KEY_LOOP, NULL, 0, "begin again after the last profile", 2},
    {"sequence", KEY_SEQUENCE, "N", 0, "number of the first profile (1)", 2},
    {"uncertainty", KEY_UNCERTAINTY, "N", 0, "half-width of a reading told to the master, device units (0)", 2},
    {"seed", KEY_SEED, "N", 0, "of everything random (1): the same seed and the same requests give the same bytes", 2},
    {NULL, 0, NULL, 0,
     "Faults of the scanner (P is a probability for each profile, with dropouts for each reading):", 3},
    {"noise", KEY_NOISE, "SIGMA", 0, "normal error of each height, input units, cut at 4 sigma", 3},
    {"dropouts", KEY_DROPOUTS, "P", 0, "a reading is missing", 3},
    {"torn", KEY_TORN, "P", 0, "the next profile takes over in the middle of a read; the torn one comes again", 3},
    {"stale", KEY_STALE, "P", 0, "for some looks the same frame stands still, or the one before is back", 3},
    {"lost", KEY_LOST, "P", 0, "one to three sequence numbers are passed over", 3},
    {"short", KEY_SHORT, "P", 0, "promises one reading too many; then the same profile again, in order", 3},
    {NULL, 0, NULL, 0, "Faults of the wire (P is a probability for each reply; at most one strikes):", 4},
    {"bad-crc", KEY_BAD_CRC, "P", 0, "one to three bits are flipped (TCP: of transaction and protocol)", 4},
    {"truncate", KEY_TRUNCATE, "P", 0, "the reply breaks off (TCP: and the connection ends)", 4},
    {"silence", KEY_SILENCE, "WHEN", 0,
     "no reply: with probability P, or START+LENGTH[,START+LENGTH…]: for LENGTH seconds from START seconds after the "
     "first request; may be repeated",
     4},
    {"exception", KEY_EXCEPTION, "P", 0, "exception 06, busy, instead of the reply", 4},
    {"garbage", KEY_GARBAGE, "P", 0, "up to 20 random bytes before the reply (RTU only)", 4},
    {"delay", KEY_DELAY, "P:MS", 0, "the reply comes MS milliseconds late", 4},
    {NULL, 0, NULL, 0, "Reports:", 5},
    {"served", KEY_SERVED, "FILE.xyz", 0, "write every reading that was served, input units", 5},
    {"progress", KEY_PROGRESS, NULL, 0,
     "on standard error, a line each time a profile is through: 'profile 12/344 valid 4836'", 5},
    {"json", KEY_JSON, NULL, 0, "progress and summary as JSON, an object a line", 5},
    {"once", KEY_ONCE, NULL, 0, "end when the sweep is over (after one more second, for a last look)", 5},
    {0}};

static const char manual[] =
    "Sweeps POINTS (a file as `canopy fit` takes it, or - for standard input) like a laser line scanner and serves the "
    "profiles on the "
    "generic profile map over real Modbus."
    "\vPrints 'rtu DEVICE' and 'tcp HOST:PORT' as it has them, then 'scene …' and 'ready' on standard output. Serves "
    "until SIGINT or SIGTERM, also after the sweep is over; then says on standard error how many readings it served. "
    "Exit status: 0 done, 1 the log could not be written, 2 bad input (one line on standard error), 64 wrong usage.";

static bool chance(const char *name, const char *text, double *to, struct canopy_fault *fault) {
    return canopy_option_real(name, text, 0, 1, to, fault);
}

// START+LENGTH, in seconds.
static bool add_period(struct mischief_options *mischief, const char *text, struct canopy_fault *fault) {
    double start_s = 0, length_s = 0;
    int used = 0;
    if (sscanf(text, "%lf+%lf%n", &start_s, &length_s, &used) != 2 || text[used] != '\0' || !(start_s >= 0) ||
        !(length_s >= 0))
        return canopy_fault_set(fault, "--silence %s: give a probability, or START+LENGTH in seconds", text);
    if (mischief->period_count == MISCHIEF_PERIODS)
        return canopy_fault_set(fault, "--silence: at most %d periods", MISCHIEF_PERIODS);
    mischief->periods[mischief->period_count].start_s = start_s;
    mischief->periods[mischief->period_count].length_s = length_s;
    mischief->period_count++;
    return true;
}

static bool silence(struct mischief_options *mischief, char *text, struct canopy_fault *fault) {
    if (strchr(text, '+') == NULL)
        return chance("silence", text, &mischief->silence, fault);
    for (char *rest = text, *one = NULL; (one = strsep(&rest, ",")) != NULL;)
        if (!add_period(mischief, one, fault))
            return false;
    return true;
}

static bool delay(struct mischief_options *mischief, char *text, struct canopy_fault *fault) {
    char *colon = strchr(text, ':');
    uint64_t ms = 0;
    if (colon == NULL)
        return canopy_fault_set(fault, "--delay %s: give P:MS", text);
    *colon = '\0';
    if (!chance("delay", text, &mischief->delay, fault) ||
        !canopy_option_whole("delay", colon + 1, 0, 60000, &ms, fault))
        return false;
    mischief->delay_us = (uint32_t)ms * 1000u;
    return true;
}

// Options of the sweep and its reports.
static bool take_sweep(struct arguments *a, int key, char *text, struct canopy_fault *fault) {
    struct canopy_sweep_options *sweep = &a->sweep;
    switch (key) {
    case KEY_PROFILES:
        return canopy_option_whole32("profiles", text, 1, CANOPY_SWEEP_PROFILES, &sweep->profiles, fault);
    case KEY_COLUMNS: return canopy_option_whole32("columns", text, 1, CANOPY_SWEEP_COLUMNS, &sweep->columns, fault);
    case KEY_UNIT: return canopy_option_real("unit", text, 1e-37, 1e37, &sweep->unit, fault);
    case KEY_RATE: return canopy_option_real("rate", text, 1e-3, 1e6, &sweep->rate_hz, fault);
    case KEY_SEED: return canopy_option_whole("seed", text, 0, UINT64_MAX, &sweep->seed, fault);
    case KEY_SEQUENCE: return canopy_option_whole16("sequence", text, 1, UINT16_MAX, &sweep->sequence, fault);
    case KEY_UNCERTAINTY: return canopy_option_whole16("uncertainty", text, 0, UINT16_MAX, &sweep->uncertainty, fault);
    case KEY_NOISE: return canopy_option_real("noise", text, 0, 1e30, &sweep->noise, fault);
    case KEY_DROPOUTS: return chance("dropouts", text, &sweep->dropouts, fault);
    case KEY_TORN: return chance("torn", text, &sweep->torn, fault);
    case KEY_STALE: return chance("stale", text, &sweep->stale, fault);
    case KEY_LOST: return chance("lost", text, &sweep->lost, fault);
    case KEY_SHORT: return chance("short", text, &sweep->short_of, fault);
    case KEY_LOOP: sweep->loop = true; break;
    case KEY_SERVED: a->served = text; break;
    case KEY_PROGRESS: a->progress = true; break;
    case KEY_JSON: a->json = true; break;
    case KEY_ONCE: a->once = true; break;
    default: break;
    }
    return true;
}

// Options of the wires.
static bool take_serve(struct arguments *a, int key, char *text, struct canopy_fault *fault) {
    struct mischief_options *mischief = &a->serve.mischief;
    switch (key) {
    case KEY_RTU: a->serve.rtu = true; return canopy_wire_line_parse(text, &a->serve.line, fault);
    case KEY_BAD_CRC: return chance("bad-crc", text, &mischief->bad_crc, fault);
    case KEY_TRUNCATE: return chance("truncate", text, &mischief->truncate, fault);
    case KEY_SILENCE: return silence(mischief, text, fault);
    case KEY_EXCEPTION: return chance("exception", text, &mischief->exception, fault);
    case KEY_GARBAGE: return chance("garbage", text, &mischief->garbage, fault);
    case KEY_DELAY: return delay(mischief, text, fault);
    case KEY_TCP: a->serve.tcp = true; return canopy_wire_tcp_parse(text, &a->serve.address, fault);
    case KEY_PACE: a->serve.pace = true; break;
    default: return take_sweep(a, key, text, fault);
    }
    return true;
}

static error_t take(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    if (key == ARGP_KEY_ARG && a->points == NULL) {
        a->points = text;
    } else if (key == ARGP_KEY_ARG) {
        argp_error(state, "one point file only");
    } else if (key == ARGP_KEY_END) {
        if (a->points == NULL)
            argp_error(state, "give a point file");
        if (!a->serve.rtu && !a->serve.tcp)
            argp_error(state, "give --rtu or --tcp");
    } else if (key < KEY_RTU) {
        return ARGP_ERR_UNKNOWN;
    } else if (!take_serve(a, key, text, &a->fault)) {
        argp_error(state, "%s", a->fault.text);
    }
    return 0;
}

// ---------------------------------------------------------------------------------------------------------------------

static volatile sig_atomic_t ended;

static void end(int signal_number) {
    (void)signal_number;
    ended = 1;
}

static void catch_signals(void) {
    struct sigaction action = {.sa_handler = end};  // without SA_RESTART: the wait must end
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    signal(SIGPIPE, SIG_IGN);
}

static void say_progress(const struct arguments *a, const struct canopy_sweep_status *s) {
    if (a->json)
        fprintf(stderr,
                "{\"event\": \"profile\", \"profile\": %" PRIu32 ", \"profiles\": %" PRIu32 ", \"round\": %" PRIu32
                ", \"sequence\": %u, \"valid\": %" PRIu64 "}\n",
                s->profile, s->profiles, s->rounds, s->sequence, s->served);
    else
        fprintf(stderr, "profile %" PRIu32 "/%" PRIu32 " valid %" PRIu64 "\n", s->profile, s->profiles, s->served);
}

static void say_over(const struct arguments *a, const struct canopy_sweep_status *s) {
    if (a->json)
        fprintf(stderr,
                "{\"event\": \"over\", \"profiles\": %" PRIu32 ", \"served\": %" PRIu64 ", \"doubtful\": %" PRIu64
                ", \"missed\": %" PRIu64 "}\n",
                s->profiles, s->served, s->doubtful, s->missed);
    else
        fprintf(stderr,
                "sweep over: %" PRIu32 " profiles, %" PRIu64 " readings served, %" PRIu64 " doubtful, %" PRIu64
                " missed\n",
                s->profiles, s->served, s->doubtful, s->missed);
}

static void say_summary(const struct arguments *a, const struct canopy_sweep_status *s, const struct serve_report *r) {
    const struct mischief *m = &r->mischief;
    const struct {
        const char *name;
        uint64_t value;
    } numbers[] = {{"served", s->served},       {"doubtful", s->doubtful}, {"missed", s->missed},
                   {"requests", r->requests},   {"replies", r->replies},   {"wire_bytes", r->wire_bytes},
                   {"rx_errors", r->rx_errors}, {"torn", s->torn},         {"stale", s->stale},
                   {"lost", s->lost},           {"short", s->short_of},    {"silence", m->silenced},
                   {"truncate", m->truncated},  {"bad_crc", m->flipped},   {"exception", m->excepted},
                   {"garbage", m->garbled},     {"delay", m->delayed}};
    const size_t count = sizeof numbers / sizeof numbers[0];
    fputs(a->json ? "{\"event\": \"end\"" : "end:", stderr);
    for (size_t i = 0; i < count; i++)
        if (a->json || numbers[i].value > 0 || i < 3)
            fprintf(stderr, a->json ? ", \"%s\": %" PRIu64 : " %s %" PRIu64, numbers[i].name, numbers[i].value);
    fputs(a->json ? "}\n" : "\n", stderr);
}

static void say_ready(const struct canopy_sweep *sweep, const struct server *server) {
    const struct canopy_sweep_status s = canopy_sweep_status(sweep);
    if (serve_device(server)[0] != '\0')
        printf("rtu %s\n", serve_device(server));
    if (serve_address(server)[0] != '\0')
        printf("tcp %s\n", serve_address(server));
    printf("scene profiles %" PRIu32 " columns %" PRIu32 " unit %.17g readings %" PRIu64 "\nready\n", s.profiles,
           s.columns, canopy_sweep_unit(sweep), s.readings);
    fflush(stdout);
}

// Serves until a signal comes, or with --once until a second after the sweep is over.
static bool run(const struct arguments *a, const struct canopy_sweep *sweep, struct server *server) {
    struct canopy_sweep_status last = canopy_sweep_status(sweep);
    uint64_t over_us = 0;
    while (!ended) {
        if (!serve_once(server, 200000)) {
            fprintf(stderr, "canopy-scanner: %s: the line is gone\n", serve_device(server));
            return false;
        }
        const struct canopy_sweep_status now = canopy_sweep_status(sweep);
        if ((a->progress || a->json) && (now.profile != last.profile || now.rounds != last.rounds))
            say_progress(a, &now);
        if (now.over && !last.over) {
            say_over(a, &now);
            over_us = serve_now_us();
        }
        if (a->once && over_us > 0 && serve_now_us() - over_us > 1000000)
            break;
        last = now;
    }
    return true;
}

static int fail(const struct canopy_fault *fault) {
    fprintf(stderr, "canopy-scanner: %s\n", fault->text);
    return EXIT_INPUT;
}

static int serve(const struct arguments *a, struct canopy_sweep *sweep, FILE *log) {
    struct canopy_fault fault;
    struct server *server = serve_open(&a->serve, sweep, &fault);
    if (server == NULL)
        return fail(&fault);
    canopy_sweep_log(sweep, log);
    catch_signals();
    say_ready(sweep, server);
    const bool well = run(a, sweep, server);
    const struct canopy_sweep_status status = canopy_sweep_status(sweep);
    const struct serve_report report = serve_report(server);
    say_summary(a, &status, &report);
    serve_close(server);
    return well ? EXIT_OK : EXIT_OUTPUT;
}

// The log is complete or the run has failed.
static int serve_logged(const struct arguments *a, struct canopy_sweep *sweep) {
    if (a->served == NULL)
        return serve(a, sweep, NULL);
    FILE *log = fopen(a->served, "w");
    if (log == NULL) {
        fprintf(stderr, "canopy-scanner: %s: %s\n", a->served, strerror(errno));
        return EXIT_INPUT;
    }
    const int status = serve(a, sweep, log);
    const bool failed = ferror(log) != 0;
    if (fclose(log) == 0 && !failed) {
        if (status == EXIT_INPUT)
            remove(a->served);
        return status;
    }
    fprintf(stderr, "canopy-scanner: %s: could not be written whole\n", a->served);
    return EXIT_OUTPUT;
}

int main(int argc, char **argv) {
    static struct arguments a = {.sweep.seed = 1};
    static const struct argp parser = {.options = table, .parser = take, .args_doc = "POINTS", .doc = manual};
    argp_program_version = "canopy-scanner " CANOPY_VERSION;
    argp_err_exit_status = EXIT_USAGE;
    argp_parse(&parser, argc, argv, 0, NULL, &a);
    a.serve.mischief_seed = canopy_random_mix(a.sweep.seed + 2);
    struct canopy_fault fault;
    struct canopy_sweep *sweep = canopy_sweep_open(a.points, &a.sweep, &fault);
    if (sweep == NULL)
        return fail(&fault);
    const int status = serve_logged(&a, sweep);
    canopy_sweep_close(sweep);
    return status;
}
