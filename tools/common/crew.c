#include "tools/common/crew.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>

#include "tools/common/progress.h"

struct crew {
    const struct canopy_fast *fast;
    const char *stage;
    atomic_uint next;  // line or column that nobody has taken yet
    uint32_t count;
};

struct member {
    struct crew *crew;
    struct canopy_fast worker;
    void *arena;
    pthread_t thread;
    bool shows;  // progress, which is for one thread
};

static void *work(void *context) {
    struct member *member = context;
    struct crew *crew = member->crew;
    for (uint32_t i = atomic_fetch_add(&crew->next, 1); i < crew->count; i = atomic_fetch_add(&crew->next, 1)) {
        canopy_fast_fit(&member->worker, i);
        if (member->shows) {
            canopy_progress(crew->stage, (double)i / (double)crew->count, 0);
        }
    }
    return NULL;
}

static bool equip(struct member *member, struct crew *crew, struct canopy_fault *fault) {
    const struct canopy_field *field = crew->fast->field;
    const size_t bytes =
        CANOPY_FAST_SHARE_ARENA(field->frame.size[0], field->frame.size[1], field->axis[1].cells, crew->fast->lines);
    member->crew = crew;
    member->arena = malloc(bytes);
    return (member->arena && canopy_fast_share(&member->worker, crew->fast, member->arena, bytes) == CANOPY_OK) ||
           canopy_fault_no_memory(fault);
}

// One stage. The first member works in the caller's thread; a thread that cannot be had is done without.
static bool run_stage(struct canopy_fast *fast, struct member *members, unsigned count, struct canopy_fault *fault) {
    struct crew crew = {.fast = fast,
                        .stage = fast->stage == CANOPY_FAST_LINES ? "fitting lines" : "fitting columns",
                        .count = canopy_fast_count(fast)};
    unsigned ready = 0, running = 1;
    while (ready < count && equip(&members[ready], &crew, fault)) {
        ready++;
    }
    const bool ok = ready == count;
    if (ok) {
        while (running < count && pthread_create(&members[running].thread, NULL, work, &members[running]) == 0) {
            running++;
        }
        members[0].shows = true;
        work(&members[0]);
        for (unsigned k = 1; k < running; k++) {
            pthread_join(members[k].thread, NULL);
        }
    }
    for (unsigned k = 0; k < count; k++) {
        if (ok) {
            canopy_fast_join(fast, &members[k].worker);
        }
        free(members[k].arena);
        members[k].arena = NULL;
    }
    return ok;
}

bool canopy_crew_run(struct canopy_fast *fast, unsigned threads, struct canopy_fault *fault) {
    struct member *members = calloc(threads, sizeof *members);
    if (!members) {
        return canopy_fault_no_memory(fault);
    }
    bool ok = true;
    while (ok && canopy_fast_count(fast) > 0) {
        ok = run_stage(fast, members, threads, fault);
        if (ok) {
            canopy_fast_end_stage(fast);
        }
    }
    free(members);
    return ok;
}
