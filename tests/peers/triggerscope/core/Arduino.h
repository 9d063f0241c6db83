// A Teensy core for POSIX: what the TriggerScope sketches use of Arduino, with every output written to a log.
// Behaviour as the Teensy core documents it: `long` and `int` have 32 bits, strings end at a NUL where C functions look.
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

typedef uint8_t byte;
typedef bool boolean;
enum { LOW = 0, HIGH = 1, INPUT = 0, OUTPUT = 1, SS = 10, MSBFIRST = 1, SPI_MODE0 = 0, FILE_WRITE = 1 };
enum { BUILTIN_SDCARD = 254, FALLING = 2, RISING = 3, CHANGE = 4 };
enum { A0 = 14, A1, A2, A3, A4 };
#define ARDUINO 10819
#define bitSet(value, bit) ((value) |= (1UL << (bit)))
#define bitClear(value, bit) ((value) &= ~(1UL << (bit)))
#define bitRead(value, bit) ((value) >> (bit) & 1)
#define bitWrite(value, bit, on) ((on) ? bitSet(value, bit) : bitClear(value, bit))

int32_t integer(const char *text);  // as `atoi` where `long` has 32 bits: saturates
#define atoi integer

void pinMode(int pin, int mode);
void digitalWrite(int pin, int level);
int digitalRead(int pin);
#define digitalWriteFast digitalWrite
#define digitalReadFast digitalRead
void delay(uint32_t milliseconds);
uint32_t millis();

class String {
  public:
    String(const char *text = "") : held(text) {}
    char &operator[](unsigned index) {
        static char outside;
        outside = 0;
        return index < held.size() ? held[index] : outside;
    }
    String &operator+=(char c) {
        held.push_back(c);
        return *this;
    }
    bool operator==(const char *other) const { return strcmp(held.c_str(), other) == 0; }
    String substring(unsigned left, unsigned right = ~0u) const;
    unsigned length() const { return held.size(); }
    const char *c_str() const { return held.c_str(); }
    int32_t toInt() const { return integer(held.c_str()); }

  private:
    std::string held;
};

class Print {
  public:
    void print(const char *text) { put(text, strlen(text)); }
    void print(const String &text) { print(text.c_str()); }
    void print(char c) { put(&c, 1); }
    void print(int value) { print(std::to_string(value).c_str()); }
    void print(unsigned value) { print(std::to_string(value).c_str()); }
    void print(byte value) { print(unsigned(value)); }
    void println() { print("\r\n"); }
    template <class T> void println(const T &value) {
        print(value);
        println();
    }

  protected:
    virtual void put(const char *data, size_t size) = 0;
};

class SerialPort : public Print {
  public:
    void begin(uint32_t) {}
    int available() const { return received.size(); }
    int read();
    explicit operator bool() const { return true; }
    std::string received, sent;

  protected:
    void put(const char *data, size_t size) override { sent.append(data, size); }
};
extern SerialPort Serial;
