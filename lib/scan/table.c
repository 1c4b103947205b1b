#include "lib/scan/table.h"

#include <stddef.h>
#include <string.h>

#include "lib/scan/field.h"
#include "lib/scan/generic.h"

static const struct canopy_profile_table *const built_in[] = {&canopy_profile_generic};

const struct canopy_profile_table *canopy_profile_at(unsigned index) {
    return index < sizeof built_in / sizeof built_in[0] ? built_in[index] : NULL;
}

const struct canopy_profile_table *canopy_profile_find(const char *name) {
    for (unsigned i = 0; canopy_profile_at(i) != NULL; i++)
        if (strcmp(canopy_profile_at(i)->name, name) == 0)
            return canopy_profile_at(i);
    return NULL;
}

// Where a field may stand: a set of 1 << enum canopy_scan_where.
enum {
    ABSENT = 1 << CANOPY_SCAN_ABSENT,
    CONSTANT = 1 << CANOPY_SCAN_CONSTANT,
    HEADER = 1 << CANOPY_SCAN_HEADER,
    DESCRIPTION = 1 << CANOPY_SCAN_DESCRIPTION,
    ANYWHERE = CONSTANT | HEADER | DESCRIPTION
};

static bool field_ok(const struct canopy_profile_table *table, const struct canopy_scan_field *field, unsigned places) {
    if (field->where > CANOPY_SCAN_DESCRIPTION || (1u << field->where & places) == 0 || field->type > CANOPY_SCAN_I32)
        return false;
    const uint32_t end = (uint32_t)field->offset + canopy_scan_words(field->type);
    if (field->where == CANOPY_SCAN_HEADER)
        return end <= table->header.count;
    if (field->where == CANOPY_SCAN_DESCRIPTION)
        return end <= table->description.count;
    return true;
}

static bool fields_ok(const struct canopy_profile_table *table) {
    return field_ok(table, &table->magic, ABSENT | DESCRIPTION) &&
           field_ok(table, &table->description_id, ABSENT | DESCRIPTION) &&
           field_ok(table, &table->header_description_id, ABSENT | HEADER) &&
           (table->description_id.where == CANOPY_SCAN_ABSENT) ==
               (table->header_description_id.where == CANOPY_SCAN_ABSENT) &&
           field_ok(table, &table->sequence, HEADER) &&
           (table->sequence.type == CANOPY_SCAN_U16 || table->sequence.type == CANOPY_SCAN_U32) &&
           field_ok(table, &table->position, ANYWHERE) && field_ok(table, &table->valid, ABSENT | HEADER) &&
           field_ok(table, &table->columns, ANYWHERE) && field_ok(table, &table->x_start, ANYWHERE) &&
           field_ok(table, &table->x_step, ANYWHERE) && field_ok(table, &table->z_offset, ANYWHERE) &&
           field_ok(table, &table->z_step, ANYWHERE | ABSENT) &&
           field_ok(table, &table->uncertainty, ANYWHERE | ABSENT);
}

static bool scene_ok(const struct canopy_profile_table *table) {
    const bool known = table->low[0].where != CANOPY_SCAN_ABSENT;
    for (int i = 0; i < 3; i++) {
        const unsigned places = known ? CONSTANT | DESCRIPTION : ABSENT;
        if (!field_ok(table, &table->low[i], places) || !field_ok(table, &table->high[i], places))
            return false;
    }
    return field_ok(table, &table->profiles, ABSENT | CONSTANT | DESCRIPTION) &&
           field_ok(table, &table->unit, ABSENT | CONSTANT | DESCRIPTION) &&
           (table->unit.where != CANOPY_SCAN_DESCRIPTION || table->unit.type == CANOPY_SCAN_U32);
}

static bool heights_ok(const struct canopy_profile_table *table) {
    if (table->heights_type > CANOPY_SCAN_I32 || table->trailer > CANOPY_SCAN_TRAILER_FIXED ||
        table->trailer_type > CANOPY_SCAN_U32 || table->trailer_type == CANOPY_SCAN_I16)
        return false;
    return table->invalid_count <= CANOPY_SCAN_INVALID_MAX && table->height_low <= table->height_high &&
           table->z_divisor >= 0 && table->z_divisor <= 1 << 30;
}

bool canopy_scan_table_ok(const struct canopy_profile_table *table) {
    return (table->function == 3 || table->function == 4) && table->order <= CANOPY_SCAN_CDAB && table->read_max > 0 &&
           table->read_max <= CANOPY_SCAN_READ_MAX && table->header.count > 0 &&
           table->header.count <= table->read_max && table->description.count <= table->read_max &&
           table->stale_us > 0 && fields_ok(table) && scene_ok(table) && heights_ok(table);
}
