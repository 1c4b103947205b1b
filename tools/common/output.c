#include "tools/common/output.h"

#include <errno.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/// What a signal has to remove.
static char *volatile pending[CANOPY_OUTPUTS_MAX];

static const int NUMBERS[] = {SIGINT, SIGTERM, SIGHUP};
#define NUMBER_COUNT (sizeof NUMBERS / sizeof NUMBERS[0])

static void remove_and_die(int number) {
    for (size_t i = 0; i < CANOPY_OUTPUTS_MAX; i++) {
        if (pending[i]) {
            unlink(pending[i]);
        }
    }
    signal(number, SIG_DFL);
    raise(number);
}

static void guard(bool on) {
    for (size_t i = 0; i < NUMBER_COUNT; i++) {
        struct sigaction now;
        if (sigaction(NUMBERS[i], NULL, &now) == 0 && now.sa_handler != SIG_IGN) {
            signal(NUMBERS[i], on ? remove_and_die : SIG_DFL);
        }
    }
}

static void expect(char *temporary) {
    size_t slot = 0;
    while (slot + 1 < CANOPY_OUTPUTS_MAX && pending[slot]) {
        slot++;
    }
    pending[slot] = temporary;
    guard(true);
}

/// The temporary file is gone, or what it should be.
static void forget(struct canopy_output *output) {
    bool any = false;
    for (size_t i = 0; i < CANOPY_OUTPUTS_MAX; i++) {
        pending[i] = pending[i] == output->temporary ? NULL : pending[i];
        any = any || pending[i];
    }
    guard(any);
    free(output->temporary);
    output->temporary = NULL;
}

static bool failed(struct canopy_output *output, struct canopy_fault *fault) {
    const int why = errno;
    canopy_fault_set(fault, "%s: cannot write: %s: give -o a file in a directory that exists and has room",
                     output->path, strerror(why));
    canopy_output_abandon(output);
    return false;
}

bool canopy_output_open(struct canopy_output *output, const char *path, struct canopy_fault *fault) {
    *output = (struct canopy_output){.path = path};
    struct stat status;
    if (strcmp(path, "-") == 0) {
        return canopy_fault_set(fault, "-: cannot write: give -o the name of a file, standard output has the report");
    }
    if (lstat(path, &status) == 0 && !S_ISREG(status.st_mode)) {
        output->file = fopen(path, "wb");  // /dev/stdout, /dev/null, a pipe, a link: nothing that may be replaced
        return output->file || failed(output, fault);
    }
    const size_t length = strlen(path);
    output->temporary = malloc(length + 8);
    if (!output->temporary) {
        return failed(output, fault);
    }
    memcpy(output->temporary, path, length);
    memcpy(output->temporary + length, ".XXXXXX", 8);
    const int descriptor = mkstemp(output->temporary);
    if (descriptor < 0) {
        const int why = errno;
        free(output->temporary);
        output->temporary = NULL;
        errno = why;
        return failed(output, fault);
    }
    expect(output->temporary);
    const mode_t mask = umask(0);  // mkstemp makes it private; give it what an ordinary file would have
    umask(mask);
    if (fchmod(descriptor, 0666 & ~mask) == 0) {
        output->file = fdopen(descriptor, "wb");
    }
    if (!output->file) {
        const int why = errno;
        close(descriptor);
        errno = why;
        return failed(output, fault);
    }
    return true;
}

static bool close_all(struct canopy_output *const outputs[], size_t count, struct canopy_fault *fault) {
    for (size_t i = 0; i < count; i++) {
        struct canopy_output *output = outputs[i];
        const bool written = fflush(output->file) == 0 && !ferror(output->file);
        const bool closed = fclose(output->file) == 0;
        output->file = NULL;
        if (!written || !closed) {
            return failed(output, fault);
        }
    }
    return true;
}

/// Gives them their names. Those that had got theirs when one did not are removed.
static bool rename_all(struct canopy_output *const outputs[], size_t count, struct canopy_fault *fault) {
    for (size_t i = 0; i < count; i++) {
        if (outputs[i]->temporary && rename(outputs[i]->temporary, outputs[i]->path) != 0) {
            failed(outputs[i], fault);
            while (i-- > 0) {
                if (outputs[i]->temporary) {
                    unlink(outputs[i]->path);
                }
            }
            return false;
        }
    }
    return true;
}

bool canopy_output_commit_all(struct canopy_output *const outputs[], size_t count, struct canopy_fault *fault) {
    sigset_t deadly;
    sigset_t before;
    sigemptyset(&deadly);
    for (size_t i = 0; i < NUMBER_COUNT; i++) {
        sigaddset(&deadly, NUMBERS[i]);
    }
    bool ok = close_all(outputs, count, fault);
    sigprocmask(SIG_BLOCK, &deadly, &before);
    ok = ok && rename_all(outputs, count, fault);
    for (size_t i = 0; i < count; i++) {
        if (!ok) {
            canopy_output_abandon(outputs[i]);
        } else if (outputs[i]->temporary) {
            forget(outputs[i]);
        }
    }
    sigprocmask(SIG_SETMASK, &before, NULL);
    return ok;
}

bool canopy_output_commit(struct canopy_output *output, struct canopy_fault *fault) {
    return canopy_output_commit_all(&output, 1, fault);
}

void canopy_output_abandon(struct canopy_output *output) {
    if (output->file) {
        fclose(output->file);
        output->file = NULL;
    }
    if (output->temporary) {
        unlink(output->temporary);
        forget(output);
    }
}
