#include "tables.h"

#include <locale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Reading files. */

enum { CHUNK = 1 << 16, LONGEST_NUMBER = 64, LONGEST_PATH = 4096, SHOWN = 60 };

/* A part of the text of a file. */
typedef struct {
    const char *begin;
    const char *end;
} Span;

/* A file that is being read: where, and for whom messages are. */
typedef struct {
    const TableSource *source;
    const Instance *instance;
    const char *function;
    size_t line;
} Reader;

#ifdef _WIN32
/* Open a file whose path is in UTF-8, which the C library of Windows takes in UTF-16 only. */
static FILE *open_file(const char *path)
{
    wchar_t wide[LONGEST_PATH];
    size_t n = 0;
    for (const unsigned char *next = (const unsigned char *)path; *next;) {
        const int following = *next < 0x80 ? 0 : *next < 0xE0 ? 1 : *next < 0xF0 ? 2 : 3;
        unsigned long code = following == 0 ? *next : *next & (0x3Fu >> following);
        ++next;
        for (int i = 0; i < following && *next; ++i) code = code << 6 | (*next++ & 0x3Fu);
        if (n + 3 > LONGEST_PATH) return NULL;
        if (code >= 0x10000) {
            wide[n++] = (wchar_t)(0xD800 + ((code - 0x10000) >> 10));
            code = 0xDC00 + ((code - 0x10000) & 0x3FF);
        }
        wide[n++] = (wchar_t)code;
    }
    wide[n] = 0;
    return _wfopen(wide, L"rb");
}
#else
static FILE *open_file(const char *path)
{
    return fopen(path, "rb");
}
#endif

/* The content of a file, to be freed; NULL if it cannot be read, which is logged. */
static char *read_file(const Reader *reader, const char *folder, size_t *size)
{
    char path[LONGEST_PATH];
    const size_t n_folder = strlen(folder), n_file = strlen(reader->source->file);
    if (n_folder + n_file + 2 > sizeof path) {
        refuse(reader->instance, STATUS_ERROR, "%s: the path of the resources is too long.", reader->function);
        return NULL;
    }
    memcpy(path, folder, n_folder);
    path[n_folder] = '/';
    memcpy(path + n_folder + 1, reader->source->file, n_file + 1);
    FILE *file = open_file(path);
    char *text = NULL;
    size_t n = 0, room = 0, got = 1;
    while (file && got > 0) {
        if (room - n < CHUNK) {
            char *larger = realloc(text, room = 2 * room + CHUNK);
            if (!larger) break;
            text = larger;
        }
        n += got = fread(text + n, 1, CHUNK, file);
    }
    const bool whole = file && got == 0 && !ferror(file);
    if (file) fclose(file);
    *size = n;
    if (whole) return text;
    free(text);
    refuse(reader->instance, STATUS_ERROR, "%s: the table %s cannot be read.", reader->function, path);
    return NULL;
}

static bool is_blank(char character)
{
    return character == ' ' || character == '\t' || character == '\r' || character == '"';
}

/* Take the part up to a separator off the front of a text, without blanks and quotation marks around it. */
static Span take(Span *text, char separator)
{
    Span part = {text->begin, text->begin};
    while (part.end < text->end && *part.end != separator) ++part.end;
    text->begin = part.end < text->end ? part.end + 1 : text->end;
    while (part.begin < part.end && is_blank(*part.begin)) ++part.begin;
    while (part.begin < part.end && is_blank(part.end[-1])) --part.end;
    return part;
}

static int shown(Span text)
{
    return text.end - text.begin < SHOWN ? (int)(text.end - text.begin) : SHOWN;
}

static bool is_text(Span part, const char *text)
{
    const size_t n = strlen(text);
    return (size_t)(part.end - part.begin) == n && memcmp(part.begin, text, n) == 0;
}

static const char *after_digits(const char *next, const char *end)
{
    while (next < end && *next >= '0' && *next <= '9') ++next;
    return next;
}

/* Whether a text is a decimal number: what strtod takes besides (hexadecimal, infinite, not a number) is refused. */
static bool is_decimal(Span text)
{
    const char *next = text.begin;
    if (next < text.end && (*next == '-' || *next == '+')) ++next;
    const char *digits = next;
    next = after_digits(next, text.end);
    size_t n_digits = (size_t)(next - digits);
    if (next < text.end && *next == '.') {
        digits = ++next;
        next = after_digits(next, text.end);
        n_digits += (size_t)(next - digits);
    }
    if (next < text.end && (*next == 'e' || *next == 'E') && n_digits > 0) {
        ++next;
        if (next < text.end && (*next == '-' || *next == '+')) ++next;
        digits = next;
        next = after_digits(next, text.end);
        n_digits = (size_t)(next - digits);
    }
    return n_digits > 0 && next == text.end;
}

/* The nearest number of double precision, whatever the locale's decimal point is; NAN if the text is none. */
static double number_of(Span text)
{
    char copy[LONGEST_NUMBER];
    const char *point = localeconv()->decimal_point;
    size_t n = 0;
    if (!is_decimal(text)) return NAN;
    for (const char *next = text.begin; next < text.end; ++next) {
        const size_t width = *next == '.' ? strlen(point) : 1;
        if (n + width >= sizeof copy) return NAN;
        memcpy(copy + n, *next == '.' ? point : next, width);
        n += width;
    }
    copy[n] = 0;
    return strtod(copy, NULL);
}

/* Whether the first line has the time in front and every column that is read; `column_of` receives the column by its
 * place in the file, n_columns where it is another one. */
static bool read_heads(const Reader *reader, Span line, size_t n_fields, size_t column_of[])
{
    const Span whole = line;
    const TableSource *source = reader->source;
    if (!is_text(take(&line, ','), "time")) {
        refuse(reader->instance, STATUS_ERROR, "%s: resources/%s, line 1: the first column is not \"time\": %.*s.",
               reader->function, source->file, shown(whole), whole.begin);
        return false;
    }
    for (size_t j = 1; j < n_fields; ++j) {
        const Span head = take(&line, ',');
        size_t i = 0;
        while (i < source->n_columns && !is_text(head, source->heads[i])) ++i;
        column_of[j] = i;
    }
    for (size_t i = 0; i < source->n_columns; ++i) {
        size_t j = 1;
        while (j < n_fields && column_of[j] != i) ++j;
        if (j < n_fields) continue;
        refuse(reader->instance, STATUS_ERROR, "%s: resources/%s, line 1: there is no column %s: %.*s.",
               reader->function, source->file, source->heads[i], shown(whole), whole.begin);
        return false;
    }
    return true;
}

static bool read_row(const Reader *reader, Span line, size_t n_fields, const size_t column_of[], Table *table)
{
    const TableSource *source = reader->source;
    double *row = table->rows + table->n_rows * source->n_columns;
    for (size_t j = 0; j < n_fields; ++j) {
        if (j > 0 && line.begin == line.end) {
            refuse(reader->instance, STATUS_ERROR, "%s: resources/%s, line %zu: %zu values instead of %zu.",
                   reader->function, source->file, reader->line, j, n_fields);
            return false;
        }
        const Span field = take(&line, ',');
        if (j > 0 && column_of[j] == source->n_columns) continue;
        const double value = number_of(field);
        if (!isfinite(value)) {
            refuse(reader->instance, STATUS_ERROR, "%s: resources/%s, line %zu, column %s: \"%.*s\" is not a finite "
                   "number.", reader->function, source->file, reader->line,
                   j == 0 ? "time" : source->heads[column_of[j]], shown(field), field.begin);
            return false;
        }
        *(j == 0 ? &table->times[table->n_rows] : &row[column_of[j]]) = value;
    }
    if (line.begin < line.end) {
        refuse(reader->instance, STATUS_ERROR, "%s: resources/%s, line %zu: more than %zu values.", reader->function,
               source->file, reader->line, n_fields);
        return false;
    }
    if (table->n_rows > 0 && !(table->times[table->n_rows] > table->times[table->n_rows - 1])) {
        refuse(reader->instance, STATUS_ERROR, "%s: resources/%s, line %zu: the time %.10g does not come after %.10g.",
               reader->function, source->file, reader->line, table->times[table->n_rows],
               table->times[table->n_rows - 1]);
        return false;
    }
    ++table->n_rows;
    return true;
}

/* Whether the rows that were read make a table. */
static bool complete(const Reader *reader, Table *table)
{
    const double span = table->n_rows > 0 ? table->times[table->n_rows - 1] - table->times[0] : 0.0;
    if (table->n_rows == 0) {
        refuse(reader->instance, STATUS_ERROR, "%s: resources/%s has no rows.", reader->function, reader->source->file);
        return false;
    }
    if (reader->source->period > 0.0 && span > reader->source->period) {
        refuse(reader->instance, STATUS_ERROR, "%s: resources/%s: its rows last %.10g s, longer than the period of "
               "%.10g s that they come again after.", reader->function, reader->source->file, span,
               reader->source->period);
        return false;
    }
    table->n_pieces = table->n_rows - (reader->source->period > 0.0 && span == reader->source->period);
    return true;
}

static bool read_lines(Reader *reader, Span text, size_t n_fields, size_t column_of[], Table *table)
{
    if (!read_heads(reader, take(&text, '\n'), n_fields, column_of)) return false;
    while (text.begin < text.end) {
        const Span line = take(&text, '\n');
        ++reader->line;
        if (line.begin < line.end && !read_row(reader, line, n_fields, column_of, table)) return false;
    }
    return complete(reader, table);
}

static size_t count(Span text, char character)
{
    size_t n = 0;
    for (const char *next = text.begin; next < text.end; ++next) n += *next == character;
    return n;
}

static bool read_table(Reader *reader, const char *folder, Table *table)
{
    const size_t n_columns = reader->source->n_columns;
    size_t size;
    char *content = read_file(reader, folder, &size);
    if (!content) return false;
    Span text = {content, content + size};
    if (size >= 3 && memcmp(content, "\xEF\xBB\xBF", 3) == 0) text.begin += 3; /* what editors put before UTF-8 */
    Span rest = text;
    const size_t n_fields = count(take(&rest, '\n'), ',') + 1, n_lines = count(rest, '\n') + 1;
    size_t *column_of = calloc(n_fields, sizeof(size_t));
    table->source = reader->source;
    table->times = calloc(n_lines * (1 + n_columns) + 2 * n_columns, sizeof(double));
    bool done = column_of && table->times;
    if (!done) refuse(reader->instance, STATUS_ERROR, "%s: out of memory.", reader->function);
    if (done) {
        table->rows = table->times + n_lines;
        table->value = table->rows + n_lines * n_columns;
        table->slope = table->value + n_columns;
        done = read_lines(reader, text, n_fields, column_of, table);
    }
    free(column_of);
    free(content);
    return done;
}

Table *tables_read(const TableSource sources[], size_t n, const char *folder, const Instance *instance,
                   const char *function)
{
    Table *tables = calloc(n, sizeof(Table));
    if (!tables) refuse(instance, STATUS_ERROR, "%s: out of memory.", function);
    for (size_t i = 0; tables && i < n; ++i) {
        Reader reader = {&sources[i], instance, function, 1};
        if (read_table(&reader, folder, &tables[i])) continue;
        tables_free(tables, n);
        tables = NULL;
    }
    return tables;
}

void tables_free(Table tables[], size_t n)
{
    for (size_t i = 0; tables && i < n; ++i) free(tables[i].times);
    free(tables);
}

/* Looking values up. */

/* The last row, of those that a piece begins at, whose time is not after the given one; that of the first row is not.
 * It is near the present row as a rule. */
static size_t find_row(const Table *table, double time, double shift)
{
    size_t low = table->row, high = table->n_pieces;
    for (int i = 0; i < 2 && table->times[low] + shift <= time; ++i) {
        if (low + 1 == table->n_pieces || time < table->times[low + 1] + shift) return low;
        ++low;
    }
    for (low = 0; high - low > 1;) {
        const size_t middle = low + (high - low) / 2;
        *(table->times[middle] + shift <= time ? &low : &high) = middle;
    }
    return low;
}

/* Lines of the columns from one row on, to another one at `until`. */
static void draw_lines(Table *table, size_t from, size_t to)
{
    const size_t n = table->source->n_columns;
    const double *begin = table->rows + from * n, *end = table->rows + to * n;
    const bool flat = table->source->held || from == to;
    for (size_t j = 0; j < n; ++j) {
        table->value[j] = begin[j];
        table->slope[j] = flat ? 0.0 : (end[j] - begin[j]) / (table->until - table->since);
    }
}

void table_go_to(Table *table, double time)
{
    const size_t last = table->n_rows - 1;
    const double period = table->source->period, first = table->times[0];
    if (period > 0.0) {
        double cycle = floor((time - first) / period);
        if (first + cycle * period > time) cycle -= 1.0; /* by rounding */
        if (first + (cycle + 1.0) * period <= time) cycle += 1.0;
        const double shift = cycle * period;
        table->row = find_row(table, time, shift);
        table->since = table->times[table->row] + shift;
        table->until = table->row + 1 < table->n_pieces ? table->times[table->row + 1] + shift
                                                         : first + (cycle + 1.0) * period;
        draw_lines(table, table->row, table->row < last ? table->row + 1 : 0);
    } else if (time < first) {
        table->row = 0;
        table->since = table->until = first;
        draw_lines(table, 0, 0);
    } else {
        table->row = find_row(table, time, 0.0);
        table->since = table->times[table->row];
        table->until = table->row < last ? table->times[table->row + 1] : INFINITY;
        draw_lines(table, table->row, table->row < last ? table->row + 1 : last);
    }
}

void table_values(const Table *table, double time, double values[])
{
    for (size_t j = 0; j < table->source->n_columns; ++j) {
        values[j] = table->value[j] + table->slope[j] * (time - table->since);
    }
}
