// canopyd: the station as a Linux process.
#include <stdio.h>
#include <unistd.h>

#include "boards/linux/daemon.h"
#include "port/linux/log.h"

static struct canopyd daemon_state;  // half a megabyte, of which the scanner's ring is most
static struct canopyd_options options;

static int serve(void) {
    struct canopy_fault fault;
    if (!canopyd_open(&daemon_state, &options, &fault)) {
        fprintf(stderr, "canopyd: %s\n", fault.text);
        return CANOPYD_EXIT_INPUT;
    }
    puts("ready");
    fflush(stdout);
    return canopyd_run(&daemon_state) ? CANOPYD_EXIT_OK : CANOPYD_EXIT_BROKEN;
}

int main(int argc, char **argv) {
    canopy_linux_log_name("canopyd");
    int status = canopyd_options_read(argc, argv, &options);
    if (status == CANOPYD_EXIT_OK) {
        status = serve();
        if (!canopyd_close(&daemon_state)) {
            _exit(status);  // the scanner's thread hangs in a read and still needs what would be freed
        }
    }
    canopyd_options_free(&options);
    return status;
}
