#include "tools/common/flow.h"

#include <pthread.h>
#include <sched.h>
#include <stdlib.h>
#include <string.h>

#include "tools/common/progress.h"
#include "tools/common/source.h"

#define BATCH 16384U  // points of a batch, but for text, which is cut by bytes
#define THREADS_LIKELY 16U

/// A batch on its way around the ring: filled by the reader, worked on by a thread, gathered by the reader.
struct slot {
    enum { EMPTY, FILLED, WORKING, DONE } state;
    struct canopy_batch batch;
    double (*raw)[3];
    uint64_t *where;
    size_t room;
    union canopy_device_point *points;
    size_t point_room;
    char *text;  ///< lines that are still to be parsed, or NULL
    size_t text_room;
    size_t text_size;
    bool first;      ///< of the file
    uint64_t lines;  ///< of the text
    uint64_t bad;    ///< the place in the text, or in the file, that `fault` is about; 0: the whole
    bool failed;
    struct canopy_fault fault;
};

struct ring {
    const struct canopy_flow *flow;
    struct slot *slots;
    unsigned slot_count;
    uint64_t filled;    ///< slots filled so far; the next to fill is filled % slot_count
    uint64_t taken;     ///< of them, those that a thread has taken
    uint64_t gathered;  ///< of them, those that are done with
    bool ended;         ///< no more will be filled
    pthread_mutex_t mutex;
    pthread_cond_t to_work;
    pthread_cond_t to_gather;
    pthread_t threads[CANOPY_THREADS_MAX];
    unsigned started;
    // of the reader's thread alone
    const char *path;
    struct canopy_source *source;
    struct canopy_points_info *info;
    uint64_t lines;  ///< of batches that were gathered
    uint64_t points;
    double part;
    bool failed;
    struct canopy_fault *fault;
};

unsigned canopy_flow_threads(void) {
    cpu_set_t set;
    const int count = sched_getaffinity(0, sizeof set, &set) == 0 ? CPU_COUNT(&set) : 1;
    return count < 1 ? 1 : (unsigned)count > THREADS_LIKELY ? THREADS_LIKELY : (unsigned)count;
}

// ---------------------------------------------------------------------------------------------------------------------
// A batch

static bool slot_fault(struct slot *slot) {
    slot->failed = true;
    return canopy_fault_set(&slot->fault, "out of memory: close other programs");
}

static bool add_point(struct slot *slot, const double point[3], uint64_t where) {
    if (slot->batch.count == slot->room) {
        const size_t room = slot->room ? slot->room * 2 : BATCH;
        double(*raw)[3] = realloc(slot->raw, room * sizeof *raw);
        slot->raw = raw ? raw : slot->raw;
        if (!raw) {
            return slot_fault(slot);
        }
        uint64_t *numbers = realloc(slot->where, room * sizeof *numbers);
        if (!numbers) {
            return slot_fault(slot);
        }
        slot->where = numbers;
        slot->room = room;
    }
    memcpy(slot->raw[slot->batch.count], point, sizeof *slot->raw);
    slot->where[slot->batch.count++] = where;
    return true;
}

static bool take_parsed(void *context, const double point[3], uint64_t where, struct canopy_fault *fault) {
    struct slot *slot = context;
    if (!add_point(slot, point, where)) {
        *fault = slot->fault;
        return false;
    }
    return true;
}

/// Room for as many device points as the batch has.
static bool make_points(struct slot *slot) {
    if (slot->point_room < slot->batch.count) {
        free(slot->points);
        slot->points = malloc(slot->batch.count * sizeof *slot->points);
        slot->point_room = slot->points ? slot->batch.count : 0;
    }
    slot->batch.raw = (const double(*)[3])slot->raw;
    slot->batch.where = slot->where;
    slot->batch.points = slot->points;
    return slot->batch.count == 0 || slot->points || slot_fault(slot);
}

/// What a thread does with a batch. Of a text with a bad line, what stands before it is worked on: the line before may
/// be worse.
static void work_on(const struct ring *ring, unsigned thread, struct slot *slot) {
    const struct canopy_flow *flow = ring->flow;
    if (slot->text_size > 0) {
        const struct canopy_points_sink sink = {slot, take_parsed};
        slot->failed = !canopy_points_parse(slot->text, slot->text_size, slot->first, sink, &slot->lines, &slot->fault);
        slot->bad = slot->lines;
    }
    if ((ring->source && !make_points(slot)) || slot->batch.count == 0 || !flow->work) {
        return;
    }
    struct canopy_fault fault;
    size_t bad = 0;
    if (!flow->work(flow->context, thread, &slot->batch, &bad, &fault)) {
        slot->failed = true;
        slot->fault = fault;
        slot->bad = slot->where && ring->source ? slot->where[bad] : 0;
    }
}

/// Takes what was made of the next batch, in the order of the file.
static void gather(struct ring *ring, struct slot *slot) {
    const struct canopy_flow *flow = ring->flow;
    if (ring->failed) {
        return;
    }
    if (slot->failed) {
        ring->failed = true;
        *ring->fault = slot->fault;
        if (slot->bad > 0) {
            canopy_points_place(ring->fault, ring->path, ring->info->by_line, ring->lines + slot->bad);
        }
        return;
    }
    slot->batch.before = ring->lines;
    ring->lines += slot->lines;
    ring->points += slot->batch.count;
    if (flow->gather && slot->batch.count > 0 && !flow->gather(flow->context, &slot->batch, ring->fault)) {
        ring->failed = true;
    }
    canopy_progress(flow->stage, ring->part, ring->points);
}

// ---------------------------------------------------------------------------------------------------------------------
// The ring

static void *run_thread(void *argument) {
    struct ring *ring = argument;
    pthread_mutex_lock(&ring->mutex);
    const unsigned thread = ring->started++;
    for (;;) {
        while (ring->taken == ring->filled && !ring->ended) {
            pthread_cond_wait(&ring->to_work, &ring->mutex);
        }
        if (ring->taken == ring->filled) {
            break;
        }
        struct slot *slot = &ring->slots[ring->taken++ % ring->slot_count];
        slot->state = WORKING;
        pthread_mutex_unlock(&ring->mutex);
        work_on(ring, thread, slot);
        pthread_mutex_lock(&ring->mutex);
        slot->state = DONE;
        pthread_cond_signal(&ring->to_gather);
    }
    pthread_mutex_unlock(&ring->mutex);
    return NULL;
}

/// Waits for the oldest batch, gathers it and empties its slot.
static void gather_oldest(struct ring *ring) {
    struct slot *slot = &ring->slots[ring->gathered % ring->slot_count];
    if (ring->flow->threads > 1) {
        pthread_mutex_lock(&ring->mutex);
        while (slot->state != DONE) {
            pthread_cond_wait(&ring->to_gather, &ring->mutex);
        }
        pthread_mutex_unlock(&ring->mutex);
    }
    gather(ring, slot);
    slot->state = EMPTY;
    ring->gathered++;
}

/// A slot to fill: empty, its result zero.
static struct slot *next_slot(struct ring *ring) {
    struct slot *slot = &ring->slots[ring->filled % ring->slot_count];
    if (ring->filled - ring->gathered == ring->slot_count) {
        gather_oldest(ring);
    }
    slot->first = ring->filled == 0;
    slot->batch.count = 0;
    slot->text_size = 0;
    slot->lines = 0;
    slot->bad = 0;
    slot->failed = false;
    memset(slot->batch.result, 0, ring->flow->result_size);
    return slot;
}

/// Hands a filled slot to the threads, or does their work.
static void submit(struct ring *ring, struct slot *slot) {
    if (ring->flow->threads <= 1) {
        ring->filled++;
        work_on(ring, 0, slot);
        slot->state = DONE;
        return;
    }
    pthread_mutex_lock(&ring->mutex);
    slot->state = FILLED;
    ring->filled++;
    pthread_cond_signal(&ring->to_work);
    pthread_mutex_unlock(&ring->mutex);
}

static bool open_ring(struct ring *ring) {
    const unsigned threads = ring->flow->threads;
    const size_t result_size = ring->flow->result_size ? ring->flow->result_size : 1;
    ring->slot_count = threads > 1 ? 2 * threads : 1;
    ring->slots = calloc(ring->slot_count, sizeof *ring->slots);
    bool ok = ring->slots != NULL;
    for (unsigned i = 0; ok && i < ring->slot_count; i++) {
        ring->slots[i].batch.result = malloc(result_size);
        ok = ring->slots[i].batch.result != NULL;
    }
    return ok || canopy_fault_set(ring->fault, "out of memory: close other programs");
}

static bool start_threads(struct ring *ring, unsigned *count) {
    pthread_mutex_init(&ring->mutex, NULL);
    pthread_cond_init(&ring->to_work, NULL);
    pthread_cond_init(&ring->to_gather, NULL);
    *count = 0;
    while (ring->flow->threads > 1 && *count < ring->flow->threads) {
        if (pthread_create(&ring->threads[*count], NULL, run_thread, ring) != 0) {
            // One is enough; without any, nobody would do the work.
            return *count > 0 || canopy_fault_set(ring->fault, "no thread can be started: give --threads 1");
        }
        ++*count;
    }
    return true;
}

static void close_ring(struct ring *ring, unsigned threads) {
    if (threads > 0) {
        pthread_mutex_lock(&ring->mutex);
        ring->ended = true;
        pthread_cond_broadcast(&ring->to_work);
        pthread_mutex_unlock(&ring->mutex);
    }
    for (unsigned i = 0; i < threads; i++) {
        pthread_join(ring->threads[i], NULL);
    }
    pthread_cond_destroy(&ring->to_gather);
    pthread_cond_destroy(&ring->to_work);
    pthread_mutex_destroy(&ring->mutex);
    for (unsigned i = 0; ring->slots && i < ring->slot_count; i++) {
        free(ring->slots[i].raw);
        free(ring->slots[i].where);
        free(ring->slots[i].points);
        free(ring->slots[i].text);
        free(ring->slots[i].batch.result);
    }
    free(ring->slots);
}

/// Opens the ring, fills it by `fill`, gathers all.
static bool run(struct ring *ring, bool (*fill)(struct ring *ring, void *what, struct canopy_fault *fault),
                void *what) {
    unsigned threads = 0;
    struct canopy_fault fault;
    bool ok = open_ring(ring);
    const bool started = start_threads(ring, &threads);
    ok = ok && started;
    if (ok) {
        const bool filled = fill(ring, what, &fault);
        while (ring->gathered < ring->filled) {
            gather_oldest(ring);
        }
        ok = !ring->failed;
        // What is wrong earlier in the file comes first.
        if (ok && !filled) {
            *ring->fault = fault;
            ok = false;
        }
    }
    close_ring(ring, threads);
    return ok;
}

// ---------------------------------------------------------------------------------------------------------------------
// From a file

static bool fill_text(struct ring *ring, struct canopy_fault *fault) {
    for (;;) {
        char *lines = NULL;
        size_t size = 0;
        const enum canopy_source_state state = canopy_source_lines(ring->source, &lines, &size, fault);
        if (state != CANOPY_SOURCE_OK) {
            return state == CANOPY_SOURCE_END;
        }
        struct slot *slot = next_slot(ring);
        if (ring->failed) {
            return true;
        }
        if (slot->text_room <= size) {
            free(slot->text);
            slot->text_room = size + 1;
            slot->text = malloc(slot->text_room);
        }
        if (!slot->text) {
            slot->text_room = 0;
            return canopy_fault_set(fault, "out of memory: close other programs");
        }
        memcpy(slot->text, lines, size);
        slot->text_size = size;
        ring->part = canopy_source_part(ring->source);
        submit(ring, slot);
    }
}

struct decoder {
    struct ring *ring;
    struct slot *slot;  ///< that is being filled, or NULL
};

static bool take_decoded(void *context, const double point[3], uint64_t where, struct canopy_fault *fault) {
    struct decoder *decoder = context;
    struct ring *ring = decoder->ring;
    if (!decoder->slot) {
        decoder->slot = next_slot(ring);
        if (ring->failed) {
            return canopy_fault_set(fault, "stopped");  // what failed is told instead
        }
    }
    if (!add_point(decoder->slot, point, where)) {
        *fault = decoder->slot->fault;
        return false;
    }
    if (decoder->slot->batch.count == BATCH) {
        ring->part = canopy_source_part(ring->source);
        submit(ring, decoder->slot);
        decoder->slot = NULL;
    }
    return true;
}

static bool fill_from_file(struct ring *ring, void *what, struct canopy_fault *fault) {
    canopy_points_reader *const *read = what;
    if (!*read) {
        return fill_text(ring, fault);
    }
    struct decoder decoder = {.ring = ring};
    const bool ok = (*read)(ring->source, (struct canopy_points_sink){&decoder, take_decoded}, ring->info, fault);
    if (decoder.slot && !ring->failed) {
        submit(ring, decoder.slot);
    }
    return ok;
}

bool canopy_flow_file(const char *path, const struct canopy_flow *flow, struct canopy_points_info *info,
                      struct canopy_fault *fault) {
    struct canopy_source source;
    canopy_points_reader *read = NULL;
    *info = (struct canopy_points_info){.by_line = true};
    if (!canopy_source_open(&source, path, fault)) {
        return false;
    }
    struct ring ring = {.flow = flow, .path = path, .source = &source, .info = info, .fault = fault};
    bool ok = canopy_points_find_reader(&source, path, &read, fault) && run(&ring, fill_from_file, &read);
    canopy_source_close(&source);
    info->count = ring.points;
    return ok && (info->count > 0 || canopy_points_none(path, info, ring.lines, fault));
}

// ---------------------------------------------------------------------------------------------------------------------
// From memory

struct list {
    const union canopy_device_point *points;
    size_t count;
};

static bool fill_from_memory(struct ring *ring, void *what, struct canopy_fault *fault) {
    const struct list *list = what;
    (void)fault;
    for (size_t at = 0; at < list->count && !ring->failed; at += BATCH) {
        struct slot *slot = next_slot(ring);
        slot->batch.count = list->count - at < BATCH ? list->count - at : BATCH;
        slot->batch.points = (union canopy_device_point *)(uintptr_t)(list->points + at);
        ring->part = (double)at / (double)list->count;
        submit(ring, slot);
    }
    return true;
}

bool canopy_flow_memory(const union canopy_device_point *points, size_t count, const struct canopy_flow *flow,
                        struct canopy_fault *fault) {
    struct canopy_flow fitting = *flow;
    if (count < 4 * (size_t)BATCH) {
        fitting.threads = 1;  // as fast as starting others
    }
    struct list list = {points, count};
    struct ring ring = {.flow = &fitting, .fault = fault};
    return run(&ring, fill_from_memory, &list);
}
