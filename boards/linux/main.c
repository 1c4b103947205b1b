// canopyd: the station as a Linux process.
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "boards/linux/daemon.h"
#include "port/linux/log.h"

static struct canopyd daemon_state;  // half a megabyte, of which the scanner's ring is most
static struct canopyd_options options;

static int serve(bool *restart) {
    struct canopy_fault fault;
    if (!canopyd_open(&daemon_state, &options, &fault)) {
        fprintf(stderr, "canopyd: %s\n", fault.text);
        return CANOPYD_EXIT_INPUT;
    }
    puts("ready");
    fflush(stdout);
    const enum canopyd_end end = canopyd_run(&daemon_state);
    *restart = end == CANOPYD_RESTART;
    return end == CANOPYD_FAILED ? CANOPYD_EXIT_BROKEN : CANOPYD_EXIT_OK;
}

// The same process from its beginning: a thread that hangs ends, and descriptors are closed. Returns if it cannot.
static int begin_again(char **argv) {
    (void)execv("/proc/self/exe", argv);
    canopy_linux_log("cannot be restarted: %s", strerror(errno));
    return CANOPYD_EXIT_BROKEN;
}

int main(int argc, char **argv) {
    canopy_linux_log_name("canopyd");
    bool restart = false;
    int status = canopyd_options_read(argc, argv, &options);
    if (status == CANOPYD_EXIT_OK) {
        status = serve(&restart);
        const bool closed = canopyd_close(&daemon_state);
        if (restart) {
            return begin_again(argv);
        }
        if (!closed) {
            _exit(status);  // the scanner's thread hangs in a read and still needs what would be freed
        }
    }
    canopyd_options_free(&options);
    return status;
}
