/// The version of canopy, written once: for the registers, the device identification and the programs.
#ifndef CANOPY_VERSION_H
#define CANOPY_VERSION_H

#define CANOPY_VERSION_MAJOR 0
#define CANOPY_VERSION_MINOR 1
#define CANOPY_VERSION_PATCH 0

#define CANOPY_VERSION_TEXT_OF(number) #number
#define CANOPY_VERSION_TEXT(major, minor, patch)                                                                       \
    CANOPY_VERSION_TEXT_OF(major) "." CANOPY_VERSION_TEXT_OF(minor) "." CANOPY_VERSION_TEXT_OF(patch)

/// "major.minor.patch"
#define CANOPY_VERSION CANOPY_VERSION_TEXT(CANOPY_VERSION_MAJOR, CANOPY_VERSION_MINOR, CANOPY_VERSION_PATCH)

#define CANOPY_VENDOR "canopy"
#define CANOPY_PRODUCT "canopy"
#define CANOPY_PRODUCT_NAME "canopy safe envelope"

#endif
