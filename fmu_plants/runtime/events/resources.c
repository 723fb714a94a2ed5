#include "resources.h"

#include "integration.h"
#include "tables.h"

#include <stdlib.h>
#include <string.h>

static int digit_of(char character)
{
    if (character >= '0' && character <= '9') return character - '0';
    if (character >= 'a' && character <= 'f') return character - 'a' + 10;
    if (character >= 'A' && character <= 'F') return character - 'A' + 10;
    return -1;
}

/* Write the path that a URI of the scheme "file" has (RFC 8089): percent-encoded, after an empty or local host. */
static void decode(const char *uri, char path[])
{
    const char *next = uri + strlen("file:");
    if (strncmp(next, "//", 2) == 0) {
        next += 2;
        if (strncmp(next, "localhost/", 10) == 0) next += 9;
    }
#ifdef _WIN32
    if (next[0] == '/' && next[1] && next[2] == ':') ++next; /* file:///C:/folder */
#endif
    while (*next) {
        const int high = *next == '%' ? digit_of(next[1]) : -1;
        const int low = high < 0 ? -1 : digit_of(next[2]);
        *path++ = low < 0 ? *next : (char)(16 * high + low);
        next += low < 0 ? 1 : 3;
    }
    *path = 0;
}

/* Whether the simulation has its tables; logs if not. */
static bool has_tables(Instance *instance, const char *location, const char *function)
{
    if (events.n_tables == 0) return true;
    if (!location || !location[0]) {
        refuse(instance, STATUS_ERROR, "%s: the location of the resources is missing; this FMU reads tables there.",
               function);
        return false;
    }
    char *folder = malloc(strlen(location) + 1);
    if (!folder) {
        refuse(instance, STATUS_ERROR, "%s: out of memory.", function);
        return false;
    }
    if (strncmp(location, "file:", 5) == 0) {
        decode(location, folder);
    } else {
        memcpy(folder, location, strlen(location) + 1);
    }
    const size_t n = strlen(folder);
    if (n > 1 && folder[n - 1] == '/') folder[n - 1] = 0;
    Table *tables = tables_read(events.tables, events.n_tables, folder, instance, function);
    free(folder);
    if (tables) simulation_use_tables(instance->simulation, tables);
    return tables != NULL;
}

Instance *instance_create_with_resources(InterfaceType type, const char *name, const char *token, bool logging_on,
                                         Logger logger, const char *location, const char *function)
{
    Instance *instance = instance_create(type, name, token, logging_on, logger, function);
    if (!instance || has_tables(instance, location, function)) return instance;
    instance_free(instance);
    return NULL;
}
